"""Estimates noise, systematic errors and mounting of a range-bearing sensor from the residuals of a run.

The smoothed path and the map of a run start a batch least-squares problem: the poses at the stamps of the
sightings, the landmarks and the sensor's parameters together, held by odometry and sightings, with outliers
downweighted. What it says about ranges is relative: a world twice as large, seen by a sensor that reads twice
as far, looks the same. So either the ranges are trusted, or the odometry, or surveyed landmarks. A bearing
bias and a turned mounting are one thing as well: of the two only the yaw of the mounting is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ._between import motion_between
from ._bordered import BLOCKS, PARAMETERS, Batch
from ._quantiles import student_t_quantile
from ._robust import SensorProblem, Solution, solve_sensor
from .config import Config, merge
from .dead_reckoning import arc_twists
from .detection import with_sightings
from .errors import ConfigError, DataError
from .evaluation.align import align_points
from .log import Controls, Floats, Ints, Log
from .result import RunResult
from .runner import configure, refuse_ranges_alone, run
from .settings import Layer
from .tuning.judge import evidence, judged

Reference: TypeAlias = Literal["sensor", "odometry", "survey"]
RANGE_PARAMETERS = ("range_scale", "range_bias_m")
PRIOR_STD = (0.1, 0.5, 1.0, 1.0, 0.5)
"""How far the parameters may be expected from the configured ones, in the order of PARAMETERS."""
SIGNIFICANT = 3.0
LEAST_GAIN = 0.25
"""A parameter is observable when its standard error is less than this share of what was assumed of it."""
LEAST_SIGHTINGS = 100
LEAST_PER_LANDMARK = 3
ASSOCIATION_REACH_M = 1.0
LEAST_MOTION_STD = np.array([1e-3, 1e-3, 1e-4])
"""Odometry is trusted to millimetres at best, or the problem could not be solved."""


@dataclass(frozen=True)
class Parameter:
    """One estimated value: dotted key below `sensor`, unit, value before and after, standard error.

    `standard_error` is NaN for the noise, which the residuals give without one. `observable` is False where
    the log says hardly more than was assumed, such as of a mounting on a straight path.
    """

    key: str
    unit: str
    configured: float
    value: float
    standard_error: float
    observable: bool = True

    @property
    def interval95(self) -> tuple[float, float]:
        """The interval that holds the true value in 95 % of logs."""
        # The standard error is itself estimated, from so many blocks.
        half = student_t_quantile(0.975, BLOCKS - 1) * self.standard_error
        return self.value - half, self.value + half

    @property
    def significant(self) -> bool:
        """Whether it is observable and SIGNIFICANT standard errors or more from the configured value."""
        return self.observable and abs(self.value - self.configured) > SIGNIFICANT * self.standard_error


@dataclass(frozen=True)
class Calibration:
    """The outcome: parameters, the settings that hold them, and how many sightings and landmarks spoke."""

    parameters: tuple[Parameter, ...]
    settings: dict[str, Any]
    """Partial configuration, to lay over that of the log."""
    converged: bool
    sightings: int
    landmarks: int
    evidence_gain: float = 0.0
    """Nats that a run with the settings found explains the log better by; below zero they are not kept."""

    def __getitem__(self, key: str) -> Parameter:
        """The parameter of a key, such as `range_scale` or `mounting.x_m`."""
        return next(parameter for parameter in self.parameters if parameter.key == key)


def calibrate(
    log: Log, config: Layer | None = None, *, reference: Reference = "sensor", noise: bool = False
) -> Calibration:
    """Run the filter over a log and estimate its sensor's parameters from what the run leaves unexplained.

    `config` is laid over the log's own settings, as for `run`. `reference` says whose scale is right: that of
    the `sensor`, of the `odometry`, or of the `survey`, the true landmarks of the log. The settings hold what
    differs from the configured value by more than SIGNIFICANT standard errors, and with `noise` the noise
    too: a filter often wants more than the residuals show, because errors that repeat do not average out.
    Sightings without an identity are taken for the nearest landmark of the run's map. Settings under which a
    run explains the log worse than before are not kept, unless a survey is the reference.
    Errors: DataError for a log with too little in it, or whose run was lost or mapped things twice;
    ConfigError for the configuration or an unknown reference.
    """
    if reference not in get_args(Reference):
        raise ConfigError(f"reference: got {reference}, expected {', '.join(get_args(Reference))}")
    log = with_sightings(log, config)
    configuration = configure(log, config or {})
    refuse_ranges_alone(configuration, "calibrate")
    result = run(log, configuration)
    fault = judged(result, log, configuration, result.doubts).fault
    if fault is not None:
        message = f"nothing can be calibrated from this run: {fault}; `fastslam tune` may find why"
        raise DataError(message, log.source)
    problem = _problem(log, configuration, result, reference)
    found = _calibration(configuration, problem, solve_sensor(problem), noise=noise)
    return _judged(found, log, result, binding=reference != "survey")


def _judged(found: Calibration, log: Log, before: RunResult, *, binding: bool) -> Calibration:
    """With how much a run gains by it; without settings where it loses and that is `binding`.

    A survey knows what no sighting tells, the scale of the world: against it a run's evidence only informs.
    """
    if not found.settings:
        return found
    after = run(log, merge(before.config, found.settings))
    gain = evidence(after, -np.inf, before.config) - evidence(before, -np.inf, before.config)
    return replace(found, evidence_gain=gain, settings=found.settings if gain >= 0 or not binding else {})


def _problem(log: Log, config: Config, result: RunResult, reference: Reference) -> SensorProblem:
    sightings, sensor = log.sightings, config["sensor"]
    usable = np.isfinite(sightings.range_m) & np.isfinite(sightings.bearing_rad)
    usable &= sightings.range_m > 0
    rows = np.flatnonzero(usable & (sightings.stamp_s <= result.smoothed.stamp_s[-1]))
    landmark = _landmarks(log, config, result, rows)
    rows, landmark = _within_range(sensor, result, sightings.stamp_s, rows, landmark)
    counts = np.bincount(landmark[landmark >= 0], minlength=len(result.landmarks.ids))
    known = (landmark >= 0) & (counts[landmark] >= LEAST_PER_LANDMARK)
    rows, landmark = rows[known], landmark[known]
    if len(rows) < LEAST_SIGHTINGS:
        message = f"calibration needs {LEAST_SIGHTINGS} sightings of landmarks seen often, got {len(rows)}"
        raise DataError(message, log.source)
    stamps, pose = np.unique(sightings.stamp_s[rows], return_inverse=True)
    used, landmark = np.unique(landmark, return_inverse=True)
    motion, covariance = _odometry(log.controls, config["motion"], stamps)
    poses, landmarks_m = _path_at(result, stamps), result.landmarks.mean_m[used]
    surveyed_m = np.full(landmarks_m.shape, np.nan)
    if reference == "survey":
        surveyed_m = _survey(log, tuple(result.landmarks.ids[index] for index in used))
        poses, landmarks_m = _in_frame_of(surveyed_m, poses, landmarks_m)
    batch = Batch(
        poses=poses,
        landmarks_m=landmarks_m,
        parameters=_configured(config),
        motion=motion,
        pose=pose,
        landmark=landmark,
        range_m=sightings.range_m[rows],
        bearing_rad=sightings.bearing_rad[rows] - sensor["bearing_bias_rad"],
        surveyed_m=surveyed_m,
    )
    free = np.array([reference != "sensor" or name not in RANGE_PARAMETERS for name in PARAMETERS])
    noise_std = np.array([sensor["range_std_m"], sensor["bearing_std_rad"]])
    return SensorProblem(batch, covariance, batch.parameters, np.where(free, PRIOR_STD, 0.0), noise_std)


def _within_range(
    sensor: dict[str, Any], result: RunResult, stamp_s: Floats, rows: Ints, landmark: Ints
) -> tuple[Ints, Ints]:
    """The sightings whose landmark lies within the sensor's limits on the map of the run.

    Limits on the ranges themselves would keep those that err towards the sensor: the scale would shrink.
    """
    pose, mounting = _path_at(result, stamp_s[rows]), sensor["mounting"]
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    sensor_x = pose[:, 0] + cosine * mounting["x_m"] - sine * mounting["y_m"]
    sensor_y = pose[:, 1] + sine * mounting["x_m"] + cosine * mounting["y_m"]
    offset = result.landmarks.mean_m[landmark] - np.column_stack([sensor_x, sensor_y])
    distance = np.hypot(*offset.T)
    kept = (landmark >= 0) & (distance > sensor["min_range_m"]) & (distance < sensor["max_range_m"])
    return rows[kept], landmark[kept]


def _configured(config: Config) -> Floats:
    sensor, mounting = config["sensor"], config["sensor"]["mounting"]
    pose = (mounting["x_m"], mounting["y_m"], mounting["yaw_rad"])
    return np.array([sensor["range_scale"], sensor["range_bias_m"], *pose])


def _survey(log: Log, names: tuple[str, ...]) -> Floats:
    """True positions of landmarks (L, 2) by name, NaN for those that nobody surveyed."""
    truth = log.truth_landmarks
    position_of = {} if truth is None else dict(zip(truth.names, truth.position_m, strict=True))
    if sum(name in position_of for name in names) < 2:
        message = "a survey as reference needs two true landmarks or more, sighted with their identities"
        raise DataError(message, log.source)
    return np.array([position_of.get(name, (np.nan, np.nan)) for name in names])


def _in_frame_of(surveyed_m: Floats, poses: Floats, landmarks_m: Floats) -> tuple[Floats, Floats]:
    """Path and map moved rigidly to where the surveyed landmarks are."""
    known = np.isfinite(surveyed_m).all(axis=1)
    transform = align_points(landmarks_m[known], surveyed_m[known])
    turned = poses[:, 2] + transform.rotation_rad
    path = np.column_stack([transform.apply_points(poses[:, :2]), turned])
    return path, transform.apply_points(landmarks_m)


def _landmarks(log: Log, config: Config, result: RunResult, rows: Ints) -> Ints:
    """Row in the result's map of each sighting (S,), -1 for none."""
    sightings = log.sightings
    if config["association"]["mode"] == "known" and (sightings.identity >= 0).any():
        index_of = {name: index for index, name in enumerate(result.landmarks.ids)}
        of_identity = np.array([index_of.get(name, -1) for name in log.identity_names] + [-1])
        known: Ints = of_identity[sightings.identity[rows]]
        return known
    if len(result.landmarks.ids) == 0:
        return np.full(len(rows), -1)
    pose = _path_at(result, sightings.stamp_s[rows])
    scale, bias_m, x_m, y_m, yaw_rad = _configured(config)
    range_m = (sightings.range_m[rows] - bias_m) / scale
    heading = pose[:, 2] + yaw_rad + sightings.bearing_rad[rows] - config["sensor"]["bearing_bias_rad"]
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    seen_x = pose[:, 0] + cosine * x_m - sine * y_m + range_m * np.cos(heading)
    seen_y = pose[:, 1] + sine * x_m + cosine * y_m + range_m * np.sin(heading)
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(result.landmarks.mean_m).query(np.column_stack([seen_x, seen_y]))
    chosen: Ints = np.where(distance < ASSOCIATION_REACH_M, nearest, -1)
    return chosen


def _path_at(result: RunResult, stamp_s: Floats) -> Floats:
    path = result.smoothed
    heading = np.unwrap(path.T_world_robot[:, 2])
    columns = (path.T_world_robot[:, 0], path.T_world_robot[:, 1], heading)
    return np.column_stack([np.interp(stamp_s, path.stamp_s, column) for column in columns])


def _odometry(controls: Controls, motion: dict[str, Any], stamp_s: Floats) -> tuple[Floats, Floats]:
    """Motion from each stamp to the next (K - 1, 3) by the controls, with its covariance (K - 1, 3, 3)."""
    twists = arc_twists(controls, motion)
    density = _noise_density(controls, motion, twists)
    moved, variance = motion_between(controls, twists, stamp_s, density**2)
    return moved, _motion_covariance(moved, variance)


def _motion_covariance(moved: Floats, variance: Floats) -> Floats:
    """Of motions with white noise: a turn half way along swings the rest of the way."""
    variance = variance + LEAST_MOTION_STD**2
    covariance = np.zeros((len(moved), 3, 3))
    covariance[:, [0, 1, 2], [0, 1, 2]] = variance
    swing = np.column_stack([-moved[:, 1], moved[:, 0]])
    covariance[:, :2, :2] += variance[:, 2, None, None] / 3 * swing[:, :, None] * swing[:, None, :]
    covariance[:, :2, 2] = covariance[:, 2, :2] = variance[:, 2, None] / 2 * swing
    return covariance


def _noise_density(controls: Controls, motion: dict[str, Any], twists: Floats) -> Floats:
    """Standard deviations ahead, left and of the turn per square root of a second, row by row (C, 3)."""
    period_s = np.diff(controls.stamp_s, append=controls.stamp_s[-1:])
    period_s[-1] = np.median(period_s) if len(period_s) > 1 else 1.0
    constant = _constant_density(controls, motion, twists, period_s)
    part, turn_rad_per_s = motion["proportional"], np.abs(twists[:, 2])
    speed_m_per_s = np.hypot(twists[:, 0], twists[:, 1])
    turning = part["turn_std_rad_per_sqrt_m"] ** 2 * speed_m_per_s
    growing = [
        part["distance_std_m_per_sqrt_m"] ** 2 * speed_m_per_s,
        part["lateral_std_m_per_sqrt_m"] ** 2 * speed_m_per_s,
        turning + part["turn_std_rad_per_sqrt_rad"] ** 2 * turn_rad_per_s,
    ]
    density: Floats = np.sqrt(constant**2 + np.column_stack(growing))
    return density


def _constant_density(controls: Controls, motion: dict[str, Any], twists: Floats, period_s: Floats) -> Floats:
    """The part of `_noise_density` that is not in proportion to the motion."""
    if motion["model"] == "increments":
        stds = [motion["x_std_m"], motion["y_std_m"], motion["heading_std_rad"]]
        return np.array(stds) / np.sqrt(period_s)[:, None]
    if motion["model"] == "odometry":
        way_m, turn_rad = np.hypot(twists[:, 0], twists[:, 1]) * period_s, np.abs(twists[:, 2]) * period_s
        ahead = np.sqrt(motion["alpha3"] * way_m**2 + motion["alpha4"] * turn_rad**2)
        turn = np.sqrt(motion["alpha1"] * turn_rad**2 + 2 * motion["alpha2"] * way_m**2)
        return np.column_stack([ahead, 0 * ahead, turn]) / np.sqrt(period_s)[:, None]
    root = np.sqrt(motion["noise_period_s"] or period_s) * np.ones(len(period_s))
    speed, slip = motion["speed_std_m_per_s"] * root, motion["lateral_std_m_per_s"] * root
    if motion["model"] == "velocity":
        return np.column_stack([speed, slip, motion["yaw_rate_std_rad_per_s"] * root])
    # The turn of a car is speed / wheelbase * tan(steering).
    steering = controls.values[:, 1] * motion["steering_gain"] + motion["steering_bias_rad"]
    by_steering = np.abs(twists[:, 0]) / motion["wheelbase_m"] / np.cos(steering) ** 2
    by_speed = np.abs(np.tan(steering)) / motion["wheelbase_m"]
    turn = np.hypot(by_steering * motion["steering_std_rad"] * root, by_speed * speed)
    return np.column_stack([speed, np.hypot(slip, motion["sensor_ahead_m"] * turn), turn])


def _calibration(config: Config, problem: SensorProblem, solution: Solution, *, noise: bool) -> Calibration:
    found = solution.problem
    error = np.sqrt(np.diag(solution.covariance))
    units = ("m/m", "m", "m", "m", "rad")
    parameters = [
        Parameter(key, unit, float(before), float(after), float(std), bool(std < LEAST_GAIN * prior))
        for key, unit, before, after, std, prior in zip(
            PARAMETERS, units, problem.prior, found.batch.parameters, error, problem.prior_std, strict=True
        )
        if prior > 0
    ]
    sensor, nan = config["sensor"], float("nan")
    noises = zip(("range_std_m", "bearing_std_rad"), ("m", "rad"), found.noise_std.tolist(), strict=True)
    for (key, unit, value), known in zip(noises, solution.noise_known, strict=True):
        parameters.append(Parameter(key, unit, sensor[key], value, nan, bool(known)))
    written = [p for p in parameters if p.significant or (noise and p.observable and p.key not in PARAMETERS)]
    return Calibration(
        parameters=tuple(parameters),
        settings=merge(*({"sensor": _nested(p.key, p.value)} for p in written)),
        converged=solution.converged,
        sightings=len(found.batch.pose),
        landmarks=len(found.batch.landmarks_m),
    )


def _nested(key: str, value: float) -> dict[str, Any]:
    head, _, rest = key.partition(".")
    return {head: _nested(rest, value)} if rest else {head: value}
