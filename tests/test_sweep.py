"""Sweeps: nothing is lost or repeated, whoever is killed."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from cli_runner import fastslam
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation.runs import summarize
from fastslam.plots.style import new_figure
from fastslam.plots.sweep import plot_sweep, varied_key
from fastslam.sweep import (
    ResultStore,
    SimulatedLog,
    StoredLog,
    SweepSpec,
    best_of,
    group_rows,
    load_spec,
    render_sweep,
    sweep_cells,
)
from fastslam.sweep.table import Group
from small_log import write_small_log
from sweep_hooks import FLAG
from test_report import read_page

if sys.platform == "win32":
    pytest.skip("kills processes by signals", allow_module_level=True)

TESTS = Path(__file__).resolve().parent


def small_spec(log: Path, *, seeds: int = 3, measure: str | None = None) -> SweepSpec:
    """Two algorithms × seeds over the small log."""
    return SweepSpec(
        logs=[StoredLog("circle", str(log))],
        grid={"algorithm": ["fastslam2", "ekf"]},
        seeds=range(seeds),
        config={"filter": {"particles": 5}},
        measure=measure,
    )


def numbers(row: dict[str, Any]) -> tuple[Any, ...]:
    """What must not depend on where and when a cell ran."""
    return (row["log"], row["point"], row["seed"], row["metrics"]["ate_rmse_m"], row["error"])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The small log on disk."""
    return write_small_log(tmp_path / "log")


def test_every_cell_has_its_own_row_and_the_same_numbers_anywhere(log: Path, tmp_path: Path) -> None:
    cells = small_spec(log).cells()
    seen: list[tuple[int, int]] = []
    two = sweep_cells(cells, ResultStore(tmp_path / "two"), processes=2, progress=lambda *n: seen.append(n))
    one = sweep_cells(cells, ResultStore(tmp_path / "one"), processes=1)
    assert len(two) == 6 and seen == [(n, 6) for n in range(7)]
    assert [numbers(row) for row in one] == [numbers(row) for row in two]
    assert len({row["key"] for row in two}) == 6
    by_seed = {row["metrics"]["ate_rmse_m"] for row in two if row["point"]["algorithm"] == "fastslam2"}
    assert len(by_seed) == 3, "the seeds must reach the filter"


def test_a_torn_last_line_is_run_again_and_nothing_else(log: Path, tmp_path: Path) -> None:
    cells = small_spec(log).cells()
    store = ResultStore(tmp_path)
    expected = [numbers(row) for row in sweep_cells(cells, store, processes=1)]
    lines = store.path.read_bytes().splitlines(keepends=True)
    store.path.write_bytes(b"".join(lines[:4]) + lines[4][:50])
    again = sweep_cells(cells, store, processes=1)
    assert [numbers(row) for row in again] == expected
    now = store.path.read_bytes().splitlines(keepends=True)
    assert now[:4] == lines[:4] and len(now) == 6
    unchanged = store.path.read_bytes()
    sweep_cells(cells, store, processes=1)
    assert store.path.read_bytes() == unchanged, "a finished sweep runs nothing"


def test_killing_the_sweep_loses_and_repeats_nothing(log: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from test_sweep import *\n"
        "if __name__ == '__main__':\n"
        f"    spec = small_spec(Path({str(log)!r}), seeds=4, measure='sweep_hooks:slow')\n"
        f"    sweep_cells(spec.cells(), ResultStore({str(tmp_path)!r}), processes=2)\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    path = os.pathsep.join([str(TESTS), *sys.path])
    process = subprocess.Popen([sys.executable, script], env={**os.environ, "PYTHONPATH": path})
    store = ResultStore(tmp_path)
    wait_for(lambda: len(store.rows()) >= 2)
    process.kill()
    process.wait()
    before = store.rows()
    assert 2 <= len(before) < 8
    cells = small_spec(log, seeds=4, measure="sweep_hooks:slow").cells()
    wait_for(lambda: not locked(store))
    rows = sweep_cells(cells, store, processes=2)
    after = store.rows()
    assert after[: len(before)] == before
    assert len(after) == 8 == len({row["key"] for row in after}) == len(rows)


def locked(store: ResultStore) -> bool:
    try:
        with store.appending():
            return False
    except DataError:
        return True


def wait_for(condition: Any, timeout_s: float = 60.0) -> None:
    """Fails the test when the condition does not come true."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.02)


def test_a_cell_whose_worker_died_is_run_again(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FLAG, str(tmp_path / "died"))
    cells = small_spec(log, measure="sweep_hooks:die_once").cells()
    rows = sweep_cells(cells, ResultStore(tmp_path), processes=2)
    assert (tmp_path / "died").exists()
    assert [row["error"] for row in rows] == [None] * 6
    assert len(ResultStore(tmp_path).rows()) == 6


def test_a_cell_that_kills_every_worker_is_reported_and_the_rest_is_done(log: Path, tmp_path: Path) -> None:
    cells = small_spec(log, measure="sweep_hooks:die_always").cells()
    rows = sweep_cells(cells, ResultStore(tmp_path), processes=1)
    errors = {row["seed"]: row["error"] for row in rows}
    assert errors == {0: None, 1: "its process died 3 times", 2: None}


def test_two_sweeps_do_not_write_into_one_folder(log: Path, tmp_path: Path) -> None:
    store = ResultStore(tmp_path)
    with store.appending(), pytest.raises(DataError, match="another sweep is writing here"):
        sweep_cells(small_spec(log).cells(), store, processes=1)


def test_a_foreign_line_is_an_error_with_its_number(log: Path, tmp_path: Path) -> None:
    store = ResultStore(tmp_path)
    store.path.write_text('{"key": "a", "metrics": {}}\nhello\n')
    with pytest.raises(DataError, match=r"cells\.jsonl:2: is no row of a sweep"):
        sweep_cells(small_spec(log).cells(), store, processes=1)


def test_seeds_make_other_worlds_when_asked(tmp_path: Path) -> None:
    worlds = {
        json.dumps(SimulatedLog("demo", preset="demo", new_world=True).describe(seed)) for seed in range(3)
    }
    same = {json.dumps(SimulatedLog("demo", preset="demo").describe(seed)) for seed in range(3)}
    assert (len(worlds), len(same)) == (3, 1)


SPEC = """\
logs:
  - path: log
    name: circle
grid:
  filter.particles: [2, 5]
seeds: 2
config:
  algorithm: fastslam1
"""


def test_the_command_writes_the_tables(log: Path, tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text(SPEC)
    outcome = fastslam("sweep", spec, "--out", tmp_path / "out", "--processes", 1)
    assert outcome.exit_code == 0, outcome.stderr
    rows = list(csv.DictReader((tmp_path / "out/results.csv").open()))
    assert [(r["log"], r["filter.particles"], r["seed"]) for r in rows] == [
        ("circle", m, s) for m in "25" for s in "01"
    ]
    assert all(0.0 < float(row["ate_rmse_m"]) < 1.0 for row in rows)
    summary = list(csv.DictReader((tmp_path / "out/summary.csv").open()))
    ate = [row for row in summary if row["metric"] == "ate_rmse_m"]
    assert [(row["filter.particles"], row["runs"], row["failed"]) for row in ate] == [
        ("2", "2", "0"),
        ("5", "2", "0"),
    ]
    mean = sum(float(row["ate_rmse_m"]) for row in rows[:2]) / 2
    assert float(ate[0]["mean"]) == pytest.approx(mean)
    figures = sorted(path.name for path in (tmp_path / "out").glob("*.png"))
    assert "ate_rmse_m.png" in figures and "filter_seconds.png" in figures


def test_the_plot_has_a_line_per_setting_of_the_other_keys() -> None:
    def group(particles: int, algorithm: str, mean: float) -> Group:
        summary = summarize([{"ate_rmse_m": mean - 0.1}, {"ate_rmse_m": mean + 0.1}])
        point = {"algorithm": algorithm, "filter.particles": particles}
        return Group(log="circle", point=point, summary=summary, failed=0)

    groups = [group(100, "fastslam1", 0.5), group(1, "fastslam1", 2.0), group(1, "ekf", 1.0)]
    key = varied_key(groups)
    assert key == "filter.particles"
    axis = plot_sweep(new_figure(4.0, 3.0).add_subplot(), groups=groups, metric="ate_rmse_m", key=key)
    lines = [container.lines[0] for container in axis.containers]
    assert [line.get_xdata().tolist() for line in lines] == [[1.0, 100.0], [1.0]]
    assert lines[0].get_ydata().tolist() == pytest.approx([2.0, 0.5])
    assert axis.get_xscale() == "log" and axis.get_ylabel() == "ate_rmse_m [m]"
    assert varied_key(groups[1:]) is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("seeds: 2", "seads: 2"), "spec.yaml:6: seads: unknown key"),
        (("seeds: 2", "seeds: -1"), "seeds: got -1, expected a number of seeds or a list"),
        (("filter.particles: [2, 5]", "filter.partikles: [2]"), "did you mean filter.particles?"),
        (("[2, 5]", "5"), "grid.filter.particles: expected a list of values"),
        (("path: log", "path: nowhere"), "does not exist"),
        (("path: log", "simulate: nowhere"), "preset: got nowhere, expected one of"),
        (("  - path: log", "  - paht: log"), "logs[0].paht: unknown key"),
        (("algorithm: fastslam1", "algoritm: ekf"), "did you mean algorithm?"),
        (("logs:", "logs: ["), "spec.yaml:"),
    ],
)
def test_a_bad_spec_is_an_error_of_one_line(
    log: Path, tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text(SPEC.replace(*change))
    outcome = fastslam("sweep", spec, "--out", tmp_path / "out")
    outcome.assert_one_line_error(exit_code=2, contains=message)
    assert not (tmp_path / "out/cells.jsonl").exists()


def test_a_failed_run_is_kept_and_run_again_on_request(log: Path, tmp_path: Path) -> None:
    spec = SweepSpec(
        logs=[StoredLog("circle", str(log))], seeds=[0], grid={"sensor.range_std_m": [0.1, -1.0]}
    )
    store = ResultStore(tmp_path)
    rows = sweep_cells(spec.cells(), store, processes=1)
    assert rows[0]["error"] is None and "sensor.range_std_m" in rows[1]["error"]
    sweep_cells(spec.cells(), store, processes=1)
    assert len(store.rows()) == 2
    sweep_cells(spec.cells(), store, processes=1, retry_failed=True)
    assert len(store.rows()) == 3


def test_a_spec_may_be_given_as_code(log: Path) -> None:
    spec = small_spec(log)
    with pytest.raises(ConfigError, match="did you mean"):
        SweepSpec(logs=spec.logs, seeds=[0], grid={"filter.partikles": [1]}).cells()


@pytest.fixture
def dask_cluster(tmp_path: Path) -> Any:
    """A scheduler and two workers with one thread each, as separate processes on loopback."""
    pytest.importorskip("distributed", reason="Dask is not installed")
    note = tmp_path / "scheduler.json"
    path = os.pathsep.join([str(TESTS), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path}
    module = [sys.executable, "-m", "distributed.cli"]
    quiet: dict[str, Any] = {"env": environment, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    scheduler = subprocess.Popen(
        [module[0], "-m", "distributed.cli.dask_scheduler", *options, "--scheduler-file", str(note)], **quiet
    )
    worker = ["--scheduler-file", str(note), "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker += ["--local-directory", str(tmp_path)]
    workers = []
    try:
        wait_for(note.exists)
        for _ in range(2):
            command = [module[0], "-m", "distributed.cli.dask_worker", *worker]
            workers.append(subprocess.Popen(command, **quiet))
        yield json.loads(note.read_text())["address"], workers
    finally:
        for process in [*workers, scheduler]:
            process.kill()
            process.wait()


def test_a_cluster_that_loses_a_worker_gives_the_same_rows(
    log: Path, tmp_path: Path, dask_cluster: Any
) -> None:
    address, workers = dask_cluster
    cells = small_spec(log, seeds=6, measure="sweep_hooks:slow").cells()
    store = ResultStore(tmp_path / "cluster")
    pids = [worker.pid for worker in workers]

    def kill_one(done: int, total: int) -> None:
        used = {row["metrics"]["pid"] for row in store.rows()}
        if used == set(pids) and workers[0].poll() is None:
            assert done < total - 2, "the sweep is over before a worker could be killed"
            os.kill(workers[0].pid, signal.SIGKILL)
            workers[0].wait()

    rows = sweep_cells(cells, store, scheduler=address, progress=kill_one)
    assert workers[0].poll() is not None, "no worker was killed"
    here = sweep_cells(small_spec(log, seeds=6).cells(), ResultStore(tmp_path / "here"), processes=1)
    assert [numbers(row) for row in rows] == [numbers(row) for row in here]
    assert len(store.rows()) == len(cells) == 12


def test_a_scheduler_that_is_not_there_is_an_error_of_one_line(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    monkeypatch.setattr("fastslam.sweep.execute.WAIT_FOR_SCHEDULER_S", 1.0)
    spec = tmp_path / "spec.yaml"
    spec.write_text(SPEC)
    outcome = fastslam("sweep", spec, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert outcome.exit_code == 2 and "cannot be reached" in outcome.stderr


def test_specs_are_read_relative_to_their_file(log: Path, tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text(SPEC)
    stored = load_spec(tmp_path / "spec.yaml").logs[0]
    assert isinstance(stored, StoredLog) and stored.path == str(log)


def made_rows(*, metric: str = "ate_rmse_m", seeds: int = 3, **centre: float) -> list[dict[str, Any]]:
    """Rows of settings named as given, whose seeds lie 0.01 m around the centre of each."""
    return [
        {
            "log": "<yard>",
            "point": {"filter.particles": int(name.strip("m"))},
            "seed": seed,
            "metrics": {metric: mean + 0.01 * (seed - (seeds - 1) / 2), "landmarks": 7},
            "wall_seconds": 1.0,
            "error": None,
        }
        for name, mean in centre.items()
        for seed in range(seeds)
    ]


def test_the_page_of_a_sweep_says_first_what_was_found() -> None:
    rows = made_rows(m5=0.5, m50=0.21, m500=0.2)
    # Half widths are 4.30 * 0.01 / sqrt(3) = 0.0248 m: 0.01 m is within that of a difference, 0.3 m is not.
    said = best_of(group_rows(rows), "<yard>")
    assert said == (
        "<yard>: least ate_rmse_m with filter.particles 500, 0.2000 m ± 0.02484 m. "
        "Of 2 other settings 1 cannot be told from it by these seeds."
    )
    rows[0] |= {"error": "it broke", "metrics": {}}
    page = render_sweep(rows, name="grid")
    found = read_page(page)
    assert found.tags.count("svg") == 1 and not {"script", "link", "img"} & set(found.tags)
    marks = ("least ate_rmse_m", "1 of 9 runs failed, the first: it broke", "<svg", "<table")
    where = [page.index(mark) for mark in marks]
    assert where == sorted(where)
    assert "&lt;yard&gt;" in page and "<yard>" not in page and "2, 1 failed</td>" in page


def test_a_sweep_without_truth_or_with_one_seed_calls_nothing_the_best_for_sure() -> None:
    assert "no truth" in best_of(group_rows(made_rows(metric="nis", m5=1.0, m50=2.0)), "<yard>")
    assert "chance" in best_of(group_rows(made_rows(seeds=1, m5=1.0, m50=2.0)), "<yard>")
    assert best_of(group_rows(made_rows(m5=1.0)), "<yard>").endswith("m ± 0.02484 m.")
