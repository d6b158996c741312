"""Reads `odometry.csv` of a native log: how the robot moved, for the log's motion model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Controls, Floats, Problem
from .clean import clean_controls
from .columns import Quantity, name_columns
from .csv_table import CsvTable, read_csv
from .graph_noise import from_covariance, wrong_row
from .planar import heading_of_quaternion, increments_between
from .wheels import Wheels, arcs_of_ticks, held_twists, increments_of_arcs, twist_of_wheels

STAMP = Quantity("stamp_s", ("timestamp", "time", "t", "time_stamp", "datetime", "epoch"), "s")
_WHEEL: tuple[str, ...] = (
    "{}",
    "{}_speed",
    "{}_velocity",
    "{}_vel",
    "{}_wheel",
    "{}_wheel_speed",
    "{}_wheel_velocity",
)
_WHEEL += ("v_{}", "speed_{}", "velocity_{}", "wheel_{}")
_TICKS = (
    "{}_tick",
    "ticks_{}",
    "{}_encoder",
    "encoder_{}",
    "enc_{}",
    "{}_count",
    "{}_counts",
    "{}_encoder_ticks",
)


def _sides(patterns: Sequence[str], side: str) -> tuple[str, ...]:
    return tuple(pattern.format(name) for pattern in patterns for name in (side, side[0]) if pattern != name)


MOTION_COVARIANCE = (
    Quantity("x_variance_m2", (), "m2"),
    Quantity("xy_covariance_m2", (), "m2"),
    Quantity("x_heading_covariance_m_rad", (), "m_rad"),
    Quantity("y_variance_m2", (), "m2"),
    Quantity("y_heading_covariance_m_rad", (), "m_rad"),
    Quantity("heading_variance_rad2", (), "rad2"),
)
MOTION_COVARIANCE_COLUMNS = tuple(quantity.name for quantity in MOTION_COVARIANCE)
QUANTITIES = (
    STAMP,
    Quantity(
        "speed_m_per_s",
        ("v", "vel", "velocity", "linear_velocity", "forward_velocity", "linear_x", "linear", "vx", "v_x"),
        "m_per_s",
    ),
    Quantity(
        "yaw_rate_rad_per_s",
        (
            "w",
            "omega",
            "angular_velocity",
            "angular_z",
            "angular",
            "turn_rate",
            "yawrate",
            "wz",
            "w_z",
            "gyro_z",
        ),
        "rad_per_s",
    ),
    Quantity("steering_rad", ("steering_angle", "steer", "steer_angle"), "rad"),
    Quantity("dx_m", ("delta_x",), "m"),
    Quantity("dy_m", ("delta_y",), "m"),
    Quantity("dheading_rad", ("dtheta", "dyaw", "delta_heading", "delta_theta", "delta_yaw"), "rad"),
    *MOTION_COVARIANCE,
    Quantity("x_m", ("position_x", "pos_x"), "m"),
    Quantity("y_m", ("position_y", "pos_y"), "m"),
    Quantity("heading_rad", ("yaw", "theta", "orientation"), "rad"),
    *(Quantity(f"q{axis}", (f"q_{axis}", f"orientation_{axis}", f"quaternion_{axis}")) for axis in "xyzw"),
    *(
        Quantity(f"{side}_m_per_s", (*_sides(_WHEEL, side), f"v{side[0]}"), "m_per_s")
        for side in ("left", "right")
    ),
    *(
        Quantity(f"{side}_rad_per_s", (*_sides(_WHEEL, side), f"w{side[0]}"), "rad_per_s")
        for side in ("left", "right")
    ),
    *(Quantity(f"{side}_ticks", _sides(_TICKS, side)) for side in ("left", "right")),
)
IGNORED: tuple[str, ...] = (
    "z",
    "position_z",
    "pos_z",
    "seq",
    "sequence",
    "frame_id",
    "child_frame_id",
    "linear_y",
    "linear_z",
)
IGNORED += ("angular_x", "angular_y", "roll", "pitch")


@dataclass(frozen=True)
class _Form:
    """Columns that say how the robot moved, the motion models that can use them, and how they are read."""

    columns: tuple[str, ...]
    models: tuple[str, ...]
    read: Callable[[CsvTable, Wheels, str], tuple[Controls, tuple[Problem, ...]]]


@dataclass(frozen=True)
class Odometry:
    """What `odometry.csv` holds, and the motion model that it is for."""

    controls: Controls
    model: str
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]
    dated: bool
    """Whether the stamps are dates."""


def read_odometry(path: Path, *, model: str | None, wheels: Wheels) -> Odometry:
    """The controls for a motion model, or for the one that the header fits. Errors: DataError with line."""
    table = read_csv(path, example="stamp_s,speed_m_per_s,yaw_rate_rad_per_s")
    return odometry_of(table, model=model, wheels=wheels)


def odometry_of(table: CsvTable, *, model: str | None, wheels: Wheels) -> Odometry:
    """The controls that a table holds under any of the names known. Errors: DataError with its line."""
    table = name_columns(table, QUANTITIES, ignored=IGNORED)
    form = _form(table, model)
    notes = table.notes
    if model is None:
        model = _only_model(form, table)
        notes = (*notes, f"log.yaml names no motion model: {model} by the columns of {table.path.name}")
    used = ("stamp_s", *form.columns, *(MOTION_COVARIANCE_COLUMNS if form.columns == _STEP else ()))
    unused = [table.written_as[name] for name in table.index_of if name not in used]
    notes = (*notes, *(f"{table.path.name}: column {name} is not used" for name in unused))
    with np.errstate(over="ignore", invalid="ignore"):
        controls, problems = form.read(table, wheels, model)
    beyond = np.flatnonzero(~np.isfinite(controls.values).all(axis=1))
    if len(beyond):
        stamp_s = controls.stamp_s[beyond[0]]
        raise DataError(f"the row at {stamp_s:.15g} s makes a motion too large to compute with", table.path)
    return Odometry(controls, model, table.problems + problems, notes, dated=table.has_dates("stamp_s"))


def _form(table: CsvTable, model: str | None) -> _Form:
    """The form whose columns are all there and that the motion model can use."""
    if "stamp_s" not in table.index_of:
        got = ",".join(table.index_of)
        raise DataError(f"column stamp_s is missing: got {got}", table.path, table.header_line)
    complete = [form for form in FORMS if all(name in table.index_of for name in form.columns)]
    fitting = [form for form in complete if model is None or model in form.models]
    if fitting:
        return fitting[0]
    got = ",".join(table.index_of)
    allowed = [form for form in FORMS if model is None or model in form.models]
    if complete:
        fits = " or ".join(complete[0].models)
        message = f"the header fits motion.model {fits}, but log.yaml says {model}: change one of them"
        expected = ",".join(("stamp_s", *allowed[0].columns))
        raise DataError(f"{message} (got {got}, expected {expected})", table.path, table.header_line)
    nearest = max(allowed, key=lambda form: sum(name in table.index_of for name in form.columns))
    missing = next(name for name in nearest.columns if name not in table.index_of)
    expected = ",".join(("stamp_s", *nearest.columns))
    message = f"column {missing} is missing: got {got}, expected {expected}"
    raise DataError(message, table.path, table.header_line)


def _only_model(form: _Form, table: CsvTable) -> str:
    if len(form.models) == 1 and form.models[0] != "ackermann":
        return form.models[0]
    first = form.models[0]
    choice = f"motion: {{model: {first}}}"
    if len(form.models) > 1:
        choice += f" (or {', '.join(form.models[1:])})"
    message = f"log.yaml names no motion model, and these columns do not settle it: add {choice} there"
    raise DataError(message, table.path, table.header_line)


def _plain(*names: str) -> Callable[[CsvTable, Wheels, str], tuple[Controls, tuple[Problem, ...]]]:
    """Columns that are the control itself."""

    def read(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
        return clean_controls(
            table.stamps("stamp_s"), _values(table, names), path=table.path, lines=table.lines
        )

    return read


def _read_steps(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    """Displacements, with a covariance for each row where the columns are there."""
    covariance = _covariance(table)
    rows = np.arange(len(table.lines), dtype=np.float64)
    values = np.column_stack([_values(table, _STEP), rows])
    controls, problems = clean_controls(table.stamps("stamp_s"), values, path=table.path)
    if covariance is not None:
        covariance = covariance[controls.values[:, 3].astype(np.int64)]
    return Controls(controls.stamp_s, controls.values[:, :3].copy(), covariance=covariance), problems


def _covariance(table: CsvTable) -> Floats | None:
    """Upper triangles (N, 6), NaN where a row has none; None without the columns, all of which must be."""
    present = [name for name in MOTION_COVARIANCE_COLUMNS if name in table.index_of]
    if not present:
        return None
    missing = [name for name in MOTION_COVARIANCE_COLUMNS if name not in present]
    if missing:
        message = f"has {present[0]} but not {missing[0]}: expected all six or none"
        raise DataError(message, table.path, table.header_line)
    values = np.column_stack([table.numbers(name, empty=math.nan) for name in MOTION_COVARIANCE_COLUMNS])
    some = np.isnan(values).any(axis=1) & ~np.isnan(values).all(axis=1)
    wrong = int(np.argmax(some)) if some.any() else wrong_row(from_covariance(values))
    if wrong is not None:
        message = (
            f"covariance: got {values[wrong].tolist()}, expected a positive definite one or six empty cells"
        )
        raise DataError(message, table.path, table.lines[wrong])
    return values


def _values(table: CsvTable, names: Sequence[str]) -> Floats:
    return np.column_stack([table.numbers(name) for name in names])


def _read_poses(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    return _increments(table, _values(table, ("x_m", "y_m", "heading_rad")))


def _read_quaternions(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    quaternion = _values(table, ("qx", "qy", "qz", "qw"))
    zero = ~(np.linalg.norm(quaternion, axis=1) > 0) & ~np.isnan(quaternion).any(axis=1)
    if zero.any():
        row = int(np.argmax(zero))
        raise DataError("the quaternion is zero, which is no orientation", table.path, table.lines[row])
    heading = heading_of_quaternion(quaternion)
    return _increments(table, np.column_stack([_values(table, ("x_m", "y_m")), heading]))


def _increments(table: CsvTable, T_odometer_robot: Floats) -> tuple[Controls, tuple[Problem, ...]]:
    poses, problems = clean_controls(
        table.stamps("stamp_s"), T_odometer_robot, path=table.path, lines=table.lines
    )
    _need_two(poses, table)
    return Controls(poses.stamp_s[1:], increments_between(poses.values)), problems


def _need_two(rows: Controls, table: CsvTable) -> None:
    if len(rows.stamp_s) < 2:
        raise DataError("holds one row, needs at least two to tell a motion", table.path)


def _read_wheel_speeds(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    left, right = (table.numbers(f"{side}_m_per_s") for side in ("left", "right"))
    track_width_m = wheels.needed("track_width_m", table.path, table.header_line)
    twists = twist_of_wheels(left, right, track_width_m)
    return clean_controls(table.stamps("stamp_s"), twists, path=table.path, lines=table.lines)


def _read_wheel_rates(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    radius_m = wheels.needed("radius_m", table.path, table.header_line)
    track_width_m = wheels.needed("track_width_m", table.path, table.header_line)
    left, right = (radius_m * table.numbers(f"{side}_rad_per_s") for side in ("left", "right"))
    twists = twist_of_wheels(left, right, track_width_m)
    return clean_controls(table.stamps("stamp_s"), twists, path=table.path, lines=table.lines)


def _read_ticks(table: CsvTable, wheels: Wheels, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    ticks = _values(table, ("left_ticks", "right_ticks"))
    rows, problems = clean_controls(table.stamps("stamp_s"), ticks, path=table.path, lines=table.lines)
    _need_two(rows, table)
    known = len(table.lines) == len(rows.stamp_s)
    lines: Sequence[int | None] = table.lines if known else [table.header_line] * len(rows.stamp_s)
    arcs = arcs_of_ticks(rows.values, wheels, path=table.path, lines=lines)
    if model == "velocity":
        return Controls(rows.stamp_s, held_twists(rows.stamp_s, arcs)), problems
    return Controls(rows.stamp_s[1:], increments_of_arcs(arcs)), problems


_BY_STEPS = ("odometry", "increments")
_TWIST = ("speed_m_per_s", "yaw_rate_rad_per_s")
_STEERING = ("speed_m_per_s", "steering_rad")
_STEP = ("dx_m", "dy_m", "dheading_rad")
FORMS = (
    _Form(_TWIST, ("velocity",), _plain(*_TWIST)),
    _Form(_STEERING, ("ackermann",), _plain(*_STEERING)),
    _Form(_STEP, _BY_STEPS, _read_steps),
    _Form(("x_m", "y_m", "heading_rad"), _BY_STEPS, _read_poses),
    _Form(("x_m", "y_m", "qx", "qy", "qz", "qw"), _BY_STEPS, _read_quaternions),
    _Form(("left_m_per_s", "right_m_per_s"), ("velocity",), _read_wheel_speeds),
    _Form(("left_rad_per_s", "right_rad_per_s"), ("velocity",), _read_wheel_rates),
    _Form(("left_ticks", "right_ticks"), ("velocity", *_BY_STEPS), _read_ticks),
)
MODELS = tuple(dict.fromkeys(model for form in FORMS for model in form.models))
