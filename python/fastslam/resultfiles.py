"""The folder of files that a run leaves, written so that no reader ever sees half a file, and read back."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from . import _core
from ._hints import does_not_exist, of_our_own
from ._yaml import YamlError, parse_yaml, write_yaml
from .csv_cells import guarded, unguarded
from .errors import DataError
from .evaluation import EvaluationOptions, Metrics, evaluate
from .health import reason_bits, reason_names, status_code, status_name
from .log import Floats, Log
from .result import LandmarkMap, Residuals, RunResult, Steps, Trajectory, Try

TRAJECTORY_FILE = "trajectory.tum"
SMOOTHED_FILE = "smoothed.tum"
LANDMARKS_FILE = "landmarks.csv"
METRICS_FILE = "metrics.json"
CONFIG_FILE = "config.yaml"
STEPS_FILE = "steps.csv"

PLACE_COLUMNS = ("id", "x_m", "y_m", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2", "sightings")
"""What the landmarks of older results have."""
LANDMARK_COLUMNS = (*PLACE_COLUMNS, "confirmed", "class", "signature")
"""What the landmarks of a map have; the last two are empty where nothing is known."""
RESIDUAL_COLUMNS = tuple(
    f"{kind}_residual{more}" for kind in ("range", "bearing") for more in ("s", "_rms", "_mean")
)
"""What those of a run have besides (`Residuals`), empty where nothing was compared."""
STEP_COLUMNS: dict[str, str] = {"stamp_s": "number", "latency_us": "number", **dict(_core.step_fields())}
"""Columns of `Steps` in the order of the file, each with its kind; status and reasons stand as names."""
COVARIANCE_COLUMNS = (
    *("stamp_s", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"),
    *("cov_xheading_m_rad", "cov_yheading_m_rad", "cov_headingheading_rad2"),
)
COVARIANCE_FILE = "trajectory_covariance.csv"
RUN_FILE = "run.json"
RUNS_FILE = "runs.json"
LOG_FILE = "log.json"
REPORT_FILE = "report.html"
SPACE_MAP_FILE = "map.csv"
FIGURES = ("map", "error", "health", "effective_sample_size", "latency")
OWN_FILES = (
    *(RUN_FILE, TRAJECTORY_FILE, SMOOTHED_FILE, COVARIANCE_FILE, LANDMARKS_FILE, METRICS_FILE, CONFIG_FILE),
    *(STEPS_FILE, RUNS_FILE, LOG_FILE, REPORT_FILE, SPACE_MAP_FILE, *(f"{name}.png" for name in FIGURES)),
)
"""Every file that a run may leave in its folder. A new run removes those of an older one and nothing else."""


_STAMP = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(-\d+)?")


def write_result(
    result: RunResult,
    log: Log,
    folder: Path | str,
    *,
    metrics: Metrics | None = None,
    options: EvaluationOptions | None = None,
) -> dict[str, Path]:
    """Write everything of a run except figures and report; returns file name to path.

    Each file appears whole or not at all (temporary name, then rename), and all of them in the place of what
    an older run left there (`OWN_FILES`; no other file is touched). Poses and landmarks are in the world
    frame of the run. `metrics` saves evaluating again. Errors: `DataError` where the folder cannot be
    written, or the estimate is not finite.
    """
    target = Path(folder)
    values = evaluate(result, log, options=options) if metrics is None else metrics
    contents = {
        TRAJECTORY_FILE: tum_text(result.trajectory),
        SMOOTHED_FILE: tum_text(result.smoothed),
        LANDMARKS_FILE: _landmarks_csv(result.landmarks),
        METRICS_FILE: to_json(values),
        CONFIG_FILE: config_yaml(result),
        RUN_FILE: to_json(_run_facts(result)),
        STEPS_FILE: _steps_csv(result.steps),
    }
    if result.trajectory.covariance is not None:
        contents[COVARIANCE_FILE] = _covariance_csv(result.trajectory)
    return replace_results(target, contents)


def replace_results(folder: Path, contents: Mapping[str, str]) -> dict[str, Path]:
    """Writes the files of a run in the place of an older run's; returns file name to path.

    All are written under temporary names first: a full disk leaves the older run whole. Then `run.json`,
    without which nothing reads the folder, goes first and comes last; `latest` beside a folder that a stamp
    names points to it then. Errors: `DataError`.
    """
    temporary = {name: folder / f".{name}.{uuid.uuid4().hex}" for name in contents}
    path = folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            for name, path in temporary.items():
                path.write_bytes(contents[name].encode())
            path = folder
            for name in OWN_FILES:
                if name == RUN_FILE or name not in contents:
                    (folder / name).unlink(missing_ok=True)
            for name in sorted(contents, key=lambda name: name == RUN_FILE):
                os.replace(temporary[name], folder / name)
        finally:
            for left in temporary.values():
                left.unlink(missing_ok=True)
    except OSError as error:
        named = folder if path is folder else folder / path.name.split(".", 2)[1]
        raise DataError(f"cannot write: {error.strerror or error}", named) from error
    if _STAMP.fullmatch(folder.name):
        _point_latest(folder.parent, folder.name)
    return {name: folder / name for name in contents}


def write_atomically(path: Path, content: str | bytes, *, durable: bool = False) -> Path:
    """Write a file under a temporary name beside it, then rename it: readers see the old or the new file.

    With `durable` that holds even if the power fails: the data are on the disk before they get their name.
    Missing folders are made. Errors: `DataError` with the reason that the system gives.
    """
    data = content.encode() if isinstance(content, str) else content
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open("wb") as file:
                file.write(data)
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            os.replace(temporary, path)
            if durable and os.name == "posix":
                _sync_folder(path.parent)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"cannot write: {error.strerror or error}", path) from error
    return path


MEASURED = "<!-- measured: begin -->", "<!-- measured: end -->"
"""What a page has around the part that an experiment writes."""


def write_measured(page: Path, text: str) -> Path:
    """Puts the text between the marks of a page.

    Errors: `DataError` for a page without marks, and for one that cannot be written.
    """
    begin, end = MEASURED
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, after = rest.partition(end)
    if not found or not closed:
        raise DataError(f"has no part between {begin} and {end}", page)
    return write_atomically(page, f"{before}{begin}\n\n{text.strip()}\n\n{end}{after}")


def _sync_folder(folder: Path) -> None:
    """Makes the names in a folder outlast a power failure."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def new_result_folder(root: Path | str = "results", *, now: datetime | None = None) -> Path:
    """Make `root/<stamp>` and return it; once it holds results `root/latest` points to it.

    A second run within the same second gets `<stamp>-2`. Where links cannot be made, `latest` is a text file
    that holds the folder's name; a `latest` that is a real folder is somebody's data and is left alone.
    Errors: `DataError`.
    """
    base = Path(root)
    stamp = (datetime.now() if now is None else now).strftime("%Y-%m-%d_%H-%M-%S")
    for attempt in range(1, 1000):
        folder = base / (stamp if attempt == 1 else f"{stamp}-{attempt}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            if base.exists() and not base.is_dir():
                raise DataError("cannot make a results folder: this is a file", base) from None
            continue
        except OSError as error:
            raise DataError(f"cannot make a results folder: {error.strerror or error}", folder) from error
        return folder
    raise DataError("a thousand results folders of this second exist", base / stamp)


def _point_latest(base: Path, name: str) -> None:
    latest = base / "latest"
    if latest.is_dir() and not latest.is_symlink():
        return
    temporary = base / f".latest.{uuid.uuid4().hex}"
    try:
        temporary.symlink_to(name, target_is_directory=True)
        os.replace(temporary, latest)
    except (OSError, NotImplementedError):
        temporary.unlink(missing_ok=True)
        write_atomically(latest, name + "\n")


def read_result(folder: Path | str) -> RunResult:
    """Read back what `write_result` wrote, for scoring it again. `latest` may be the text file or the link.

    Errors: `DataError` with file and line for anything missing or malformed.
    """
    source = _resolve(folder)
    facts = _read_run_facts(source / RUN_FILE)
    trajectory = _read_tum(source / TRAJECTORY_FILE)
    covariance = _read_covariance(source / COVARIANCE_FILE, len(trajectory.stamp_s))
    return RunResult(
        log_name=facts["log"],
        config=_read_config(source / CONFIG_FILE),
        version=facts["version"],
        trajectory=Trajectory(trajectory.stamp_s, trajectory.T_world_robot, covariance),
        smoothed=_read_tum(source / SMOOTHED_FILE),
        landmarks=_read_landmarks(source / LANDMARKS_FILE),
        steps=_read_steps(source / STEPS_FILE),
        filter_seconds=float(facts["filter_seconds"]),
        peak_memory_bytes=facts["peak_memory_bytes"],
        map_rows=facts["map_rows"],
        map_bytes=facts["map_bytes"],
        interrupted=facts["interrupted"],
        counts=facts["counts"],
        verdict=tuple(facts["verdict"]),
        warnings=tuple(facts["warnings"]),
        findings=tuple(facts.get("findings", ())),
        noise=facts["noise"],
        calibration=dict(facts.get("calibration", {})),
        tries=_tries(facts.get("tries", []), source / RUN_FILE),
    )


def _resolve(folder: Path | str) -> Path:
    """The results folder, where `latest` may be a text file that names it."""
    path = Path(folder)
    if path.is_file() and path.name == "latest":
        path = path.parent / _read_text(path).strip()
    if not path.is_dir():
        raise DataError(f"no such results folder: {does_not_exist(path)}", path)
    if not (path / RUN_FILE).exists():
        what = of_our_own(path) or f"holds no {RUN_FILE}"
        raise DataError(f"{what}; expected a folder of results, as `fastslam run` leaves them", path)
    return path


def to_json(value: Any) -> str:
    """JSON with two-space indent; numbers that are not finite become null, as JSON has none."""
    return json.dumps(_plain(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    """Nested builtin types, without NumPy scalars or infinities."""
    if isinstance(value, dict):
        return {str(key): _plain(member) for key, member in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(member) for member in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def config_yaml(result: RunResult) -> str:
    """The effective configuration, seed included, fit to be given to a run again."""
    header = f"# fastslam {result.version}, effective configuration of a run over {result.log_name}\n"
    return header + write_yaml(_plain(result.config))


def _run_facts(result: RunResult) -> dict[str, Any]:
    """What no other file holds and reading the run back needs."""
    return {
        "version": result.version,
        "log": result.log_name,
        "seed": result.config.get("seed"),
        "filter_seconds": float(result.filter_seconds),
        "peak_memory_bytes": int(result.peak_memory_bytes),
        "map_rows": int(result.map_rows),
        "map_bytes": int(result.map_bytes),
        "interrupted": bool(result.interrupted),
        "counts": dict(result.counts),
        "verdict": list(result.verdict),
        "warnings": list(result.warnings),
        "findings": list(result.findings),
        "noise": dict(result.noise),
        "calibration": dict(result.calibration),
        "tries": [asdict(one) for one in result.tries],
    }


def tum_text(trajectory: Trajectory) -> str:
    """Lines `stamp x y z qx qy qz qw`; stamps come back to the bit, to meet those of the truth."""
    half = 0.5 * trajectory.T_world_robot[:, 2]
    columns = (trajectory.stamp_s, *trajectory.T_world_robot[:, :2].T, np.sin(half), np.cos(half))
    lines = (
        f"{float(stamp)!r} {x:.9g} {y:.9g} 0 0 0 {qz:.12g} {qw:.12g}\n"
        for stamp, x, y, qz, qw in zip(*columns, strict=True)
    )
    return "# stamp_s x_m y_m z_m qx qy qz qw (T_world_robot)\n" + "".join(lines)


def path_csv_text(trajectory: Trajectory) -> str:
    """`stamp_s`, `x_m`, `y_m`, `heading_rad`, a line per pose."""
    columns = (trajectory.stamp_s, *trajectory.T_world_robot.T)
    rows = (
        (f"{float(stamp)!r}", *(f"{value:.9g}" for value in pose))
        for stamp, *pose in zip(*columns, strict=True)
    )
    return csv_text(("stamp_s", "x_m", "y_m", "heading_rad"), rows)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table as text, with a header."""
    lines = [",".join(columns), *(",".join(_quoted(cell) for cell in row) for row in rows)]
    return "\n".join(lines) + "\n"


def _quoted(cell: str) -> str:
    if any(mark in cell for mark in ',"\n\r'):
        return '"' + cell.replace('"', '""') + '"'
    return cell


def landmark_rows(landmarks: LandmarkMap) -> Iterator[tuple[str, ...]]:
    """The cells of `LANDMARK_COLUMNS`, a row per landmark."""
    places = zip(landmarks.ids, landmarks.mean_m, landmarks.covariance_m2, landmarks.sightings, strict=True)
    return (
        (
            *(
                guarded(name),
                *(f"{value:.9g}" for value in (*mean, cov[0, 0], cov[0, 1], cov[1, 1])),
                str(int(seen)),
            ),
            "" if landmarks.confirmed is None else str(int(landmarks.confirmed[row])),
            guarded(landmarks.class_name(row)),
            _signature_cell(landmarks, row),
        )
        for row, (name, mean, cov, seen) in enumerate(places)
    )


def _landmarks_csv(landmarks: LandmarkMap) -> str:
    columns = {name: column for of in landmarks.residuals for name, column in of.to_columns().items()}
    nothing = np.full(len(landmarks.ids), math.nan)
    numbers = np.array([columns.get(name, nothing) for name in RESIDUAL_COLUMNS], dtype=np.float64)
    more = zip(landmark_rows(landmarks), numbers.T, strict=True)
    rows = ((*row, *(f"{n:.9g}" if math.isfinite(n) else "" for n in cells)) for row, cells in more)
    return csv_text((*LANDMARK_COLUMNS, *RESIDUAL_COLUMNS), rows)


def _signature_cell(landmarks: LandmarkMap, row: int) -> str:
    value = math.nan if landmarks.signature is None else float(landmarks.signature[row])
    return f"{value:.9g}" if math.isfinite(value) else ""


def step_columns(steps: Steps) -> dict[str, Any]:
    """The columns of `steps.csv` in its order: arrays, but status and reasons as names (`a+b`)."""
    named: dict[str, Callable[[int], str]] = {
        "status": status_name,
        "reasons": lambda bits: "+".join(reason_names(bits)),
    }
    return {
        name: [named[kind](int(value)) for value in getattr(steps, name)]
        if kind in named
        else getattr(steps, name)
        for name, kind in STEP_COLUMNS.items()
    }


def _steps_csv(steps: Steps) -> str:
    columns = [
        [_step_cell(value, name, STEP_COLUMNS[name]) for value in column]
        for name, column in step_columns(steps).items()
    ]
    return csv_text(tuple(STEP_COLUMNS), zip(*columns, strict=True))


def _step_cell(value: Any, name: str, kind: str) -> str:
    if name == "stamp_s":
        return repr(float(value))
    if kind in ("status", "reasons"):
        return str(value)
    return f"{value:.9g}" if kind == "number" else str(int(value))


def covariance_columns(covariance: Floats) -> dict[str, Floats]:
    """Covariances of poses (T, 3, 3) as the columns of their file."""
    upper = covariance[:, (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)]
    return dict(zip(COVARIANCE_COLUMNS[1:], upper.T, strict=True))


def _covariance_csv(trajectory: Trajectory) -> str:
    assert trajectory.covariance is not None
    columns = covariance_columns(trajectory.covariance).values()
    rows = (
        (repr(float(stamp)), *(f"{value:.9g}" for value in row))
        for stamp, *row in zip(trajectory.stamp_s, *columns, strict=True)
    )
    return csv_text(COVARIANCE_COLUMNS, rows)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError("no such file in the results folder", path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"cannot read: {error}", path) from error


def _read_config(path: Path) -> dict[str, Any]:
    try:
        config, _ = parse_yaml(_read_text(path))
    except YamlError as error:
        raise DataError(f"not YAML: {error.message}", path, error.line) from None
    if not isinstance(config, dict):
        raise DataError("expected a mapping of settings", path, 1)
    return config


def _read_run_facts(path: Path) -> dict[str, Any]:
    try:
        facts = json.loads(_read_text(path))
    except json.JSONDecodeError as error:
        raise DataError(f"not JSON: {error.msg}", path, error.lineno) from error
    kinds: dict[str, Any] = {"version": str, "log": str, "filter_seconds": (int, float)}
    kinds |= {"peak_memory_bytes": int, "map_rows": int, "map_bytes": int}
    kinds |= {"interrupted": bool, "counts": dict, "warnings": list, "noise": dict}
    if isinstance(facts, dict):
        # Results of earlier versions have none.
        facts.setdefault("verdict", [])
        kinds["verdict"] = list
    for name, kind in kinds.items():
        if not isinstance(facts, dict) or not isinstance(facts.get(name), kind):
            raise DataError(f"`{name}` is missing or of the wrong type", path)
    return dict(facts)


def _try(seed: Any, log_evidence: Any, landmarks: Any, agreement: Any) -> Try:
    return Try(
        int(seed), float(log_evidence), int(landmarks), None if agreement is None else float(agreement)
    )


def _tries(facts: Any, path: Path) -> tuple[Try, ...]:
    try:
        return tuple(_try(**one) for one in facts)
    except (TypeError, ValueError):
        raise DataError("`tries` is of the wrong type", path) from None


def _read_tum(path: Path) -> Trajectory:
    rows = []
    for number, line in enumerate(_read_text(path).splitlines(), start=1):
        fields = line.split("#", 1)[0].split()
        if not fields:
            continue
        if len(fields) != 8:
            raise DataError(f"expected 8 numbers `stamp x y z qx qy qz qw`, got {len(fields)}", path, number)
        rows.append([_number(field, float, path, number) for field in fields])
    table = np.array(rows, dtype=float).reshape(-1, 8)
    heading = 2.0 * np.arctan2(table[:, 6], table[:, 7])
    heading = (heading + np.pi) % (2.0 * np.pi) - np.pi
    return Trajectory(table[:, 0], np.column_stack([table[:, 1:3], heading]))


def _read_table(
    path: Path, columns: Sequence[str], *, older: Sequence[Sequence[str]] = ()
) -> list[tuple[int, list[str]]]:
    """Line numbers and cells of a CSV file with exactly this header, or an older, shorter one."""
    reader = csv.reader(io.StringIO(_read_text(path), newline=""))
    header = next(reader, [])
    columns = next((one for one in older if header == list(one)), columns)
    if header != list(columns):
        raise DataError(f"expected the header {','.join(columns)}, got {','.join(header)}", path, 1)
    return _rows(reader, len(columns), path)


def _rows(reader: Any, width: int, path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and cells of the rows below a header."""
    rows = []
    try:
        for row in reader:
            if len(row) != width:
                raise DataError(f"expected {width} cells, got {len(row)}", path, reader.line_num)
            rows.append((reader.line_num, row))
    except csv.Error as error:
        raise DataError(f"not CSV: {error}", path, reader.line_num) from error
    return rows


def _number(cell: str, kind: Callable[[str], Any], path: Path, line: int) -> Any:
    try:
        return kind(cell)
    except ValueError:
        expected = "a number" if kind in (int, float) else "a name that this version knows"
        raise DataError(f"expected {expected}, got {cell!r}", path, line) from None


def _read_landmarks(path: Path) -> LandmarkMap:
    columns = (*LANDMARK_COLUMNS, *RESIDUAL_COLUMNS)
    rows = _read_table(path, columns, older=(LANDMARK_COLUMNS, PLACE_COLUMNS))
    places = len(PLACE_COLUMNS)
    numbers = [[_number(cell, float, path, line) for cell in row[1:places]] for line, row in rows]
    table = np.array(numbers, dtype=float).reshape(-1, 6)
    more = [row[places:] for _, row in rows]
    confirmed = [
        int(_number(cells[0], int, path, line))
        for cells, (line, _) in zip(more, rows, strict=True)
        if any(cells[:1])
    ]
    classes = [unguarded(cells[1]) if any(cells[1:2]) else "" for cells in more]
    names = tuple(sorted({name for name in classes if name}))
    signatures = [
        _number(cells[2], float, path, line) if any(cells[2:3]) else math.nan
        for cells, (line, _) in zip(more, rows, strict=True)
    ]
    return LandmarkMap(
        ids=tuple(unguarded(row[0]) for _, row in rows),
        mean_m=table[:, :2],
        covariance_m2=table[:, [2, 3, 3, 4]].reshape(-1, 2, 2),
        sightings=table[:, 5].astype(np.int64),
        confirmed=np.array(confirmed, dtype=np.bool_) if rows and len(confirmed) == len(rows) else None,
        class_index=np.array([names.index(name) if name else -1 for name in classes], dtype=np.int64)
        if names
        else None,
        signature=np.array(signatures) if np.isfinite(signatures).any() else None,
        class_names=names,
        residuals=_residuals(path, [(line, row[len(LANDMARK_COLUMNS) :]) for line, row in rows]),
    )


def _residuals(path: Path, rows: list[tuple[int, list[str]]]) -> tuple[Residuals, ...]:
    """The residuals of each kind of which some landmark has one."""
    found = []
    for first in range(0, len(RESIDUAL_COLUMNS), 3):
        cells = [[cell or "nan" for cell in row[first : first + 3]] for _, row in rows]
        if not any(cells):
            continue
        lines = zip(cells, rows, strict=True)
        table = np.array([[_number(cell, float, path, line) for cell in of] for of, (line, _) in lines])
        if np.isfinite(table[:, 0]).any():
            kind = RESIDUAL_COLUMNS[first].partition("_")[0]
            found.append(Residuals(kind, table[:, 0].astype(np.int64), table[:, 1], table[:, 2]))
    return tuple(found)


_STEP_READERS: dict[str, tuple[Callable[[str], Any], Any, Any]] = {
    # How a cell is read, the type of the array, and what stands for a column of newer versions.
    "number": (float, np.float64, math.nan),
    "count": (int, np.int64, -1),
    "flag": (int, np.bool_, False),
    "status": (status_code, np.int64, 0),
    "reasons": (reason_bits, np.int64, 0),
}


def _read_steps(path: Path) -> Steps:
    reader = csv.reader(io.StringIO(_read_text(path), newline=""))
    header = next(reader, [])
    unknown = [name for name in header if name not in STEP_COLUMNS]
    if unknown or "stamp_s" not in header or len(set(header)) < len(header):
        raise DataError(f"expected the header {','.join(STEP_COLUMNS)}, got {','.join(header)}", path, 1)
    rows = _rows(reader, len(header), path)
    columns: dict[str, Any] = {}
    for name, kind in STEP_COLUMNS.items():
        parse, dtype, absent = _STEP_READERS[kind]
        if name in header:
            cells = ((row[header.index(name)], line) for line, row in rows)
            columns[name] = np.array([_number(cell, parse, path, line) for cell, line in cells], dtype=dtype)
        else:
            columns[name] = np.full(len(rows), absent, dtype=dtype)
    return Steps(**columns)


def _read_covariance(path: Path, expected: int) -> Floats | None:
    if not path.exists():
        return None
    rows = _read_table(path, COVARIANCE_COLUMNS)
    if len(rows) != expected:
        raise DataError(f"expected {expected} rows, one per pose, got {len(rows)}", path)
    numbers = [[_number(cell, float, path, line) for cell in row[1:]] for line, row in rows]
    upper = np.array(numbers, dtype=float).reshape(-1, 6)
    return upper[:, [0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(-1, 3, 3)
