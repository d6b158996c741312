"""UTIAS MR.CLAM: five robots among fifteen barcode cylinders; any one robot is a log with known identities.

Times are Unix seconds. Quirks handled: measurements carry barcodes, mapped through the data set's own
table; readings of other robots and of barcodes in no table are dropped; odometry rows that repeat a stamp
are dropped. In data set 1 (told by its table, its time or the name of its folder) the table swaps the
barcodes of subjects 11 and 17: the data of all five robots says 11 -> 61 and 17 -> 18. Truth is the
motion-capture path where the file is there, else the averages per second that third parties made for data
set 1 (the mean over half a second to either side of its stamp): positions only, since their headings are
wrong where they wrap.

The noise was measured on data set 6: odometry error grows like white noise of about 0.011 m/s and 0.035
rad/s held for a second; ranges spread by 0.08-0.18 m, bearings by 0.01 rad with heavy tails. The settings are
wider: each robot's range scale is off by up to 3 % and, in data set 6, its motion lags the odometry by about
0.2 s, so that errors repeat from frame to frame (hence also the likelihood exponent). What
settings that are no facts are worth is in `docs/adr/0016-settings-that-logs-bring.md`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Floats, Ints, Log, Problem, Sightings, TruthLandmarks, TruthTrajectory
from .clean import clean_controls, clean_sightings
from .options import LoadOptions
from .planar import wrap_to_pi
from .text import find_file, read_table, refuse_not_finite, whole_numbers
from .utias_files import RobotFiles, files_of_robot, holds_data_set

AVERAGES = "third_party_groundtruth_1hz"
FIRST_SET_SPAN_S = (1248272263.0, 1248273770.0)
"""Unix time of the recording of data set 1, on 22 July 2009."""
FIRST_SET_BARCODES = dict(
    enumerate((5, 14, 41, 32, 23, 72, 27, 54, 70, 36, 18, 25, 9, 81, 16, 90, 61, 45, 7, 63), start=1)
)
"""The table of data set 1 as published."""
FIELD_OF_VIEW_RAD = 1.2
"""All bearings lie within +-0.592 rad."""
MAX_RANGE_M = 10.0
"""All ranges lie below 9.6 m."""
ASSOCIATION: dict[str, Any] = {
    "method": "sampled",
    "new_landmark_density": 0.001,
    "clutter_density": 0.001,
    "detection_probability": 0.3,
    "merging": {"rule": "nearby", "tolerance_std_m": 0.2},
    "existence": {
        "form": "bayes",
        "removal": "when_missed",
        "lowest_log_odds": -3.0,
        "highest_log_odds": 30.0,
        "confirmed_sightings": 15,
        "range_fraction": 0.32,
        "view_fraction": 0.8,
    },
}
"""For those who ignore the identities. Scans of one or two sightings are ambiguous until the pose is sure:
particles try all explanations, and those whose maps hold what is not seen lose; paths drawn anew then
straighten what the early guesses have bent. A third to three quarters of what is in view within 3 m is
sighted."""


def matches(path: Path) -> bool:
    """A folder with the odometry of a robot beside barcodes or measurements, or such an odometry file."""
    return holds_data_set(path)


def load(path: Path, options: LoadOptions) -> Log:
    """Read one robot (1 unless given). Errors: DataError for a robot that is not there or a faulty file."""
    files = files_of_robot(path, options.robot)
    landmarks = read_table(files.landmarks, 5)
    refuse_not_finite(files.landmarks, landmarks[:, :3])
    subjects = whole_numbers(files.landmarks, landmarks[:, 0]).tolist()
    odometry = read_table(files.odometry, 3)
    controls, control_problems = clean_controls(odometry[:, 0], odometry[:, 1:], path=files.odometry)
    subject_of_barcode, table_problems = _barcodes(files, float(controls.stamp_s[0]))
    raw, drop_problems = _sightings(read_table(files.measurement, 4), subject_of_barcode, subjects)
    sightings, sighting_problems = clean_sightings(raw, path=files.measurement)
    truth = _truth_trajectory(files)
    names = tuple(str(subject) for subject in subjects)
    return Log(
        name=_name(path, files),
        source=str(path),
        format="utias",
        controls=controls,
        sightings=sightings,
        identity_names=names,
        truth_trajectory=truth,
        truth_landmarks=TruthLandmarks(names, landmarks[:, 1:3]),
        config=_config(truth, float(controls.stamp_s[0])),
        problems=table_problems + control_problems + drop_problems + sighting_problems,
    )


def _name(path: Path, files: RobotFiles) -> str:
    """The folder's name with the robot's number, or the name of the file that was named."""
    if path.is_file():
        return path.name.split(".")[0]
    folder = path.resolve().name
    return folder if files.number is None else f"{folder}_robot{files.number}"


def _barcodes(files: RobotFiles, start_s: float) -> tuple[dict[float, int], tuple[Problem, ...]]:
    file = files.barcodes
    subjects, barcodes = (whole_numbers(file, column) for column in read_table(file, 2).T)
    barcode_of_subject = dict(zip(subjects.tolist(), barcodes.tolist(), strict=True))
    problems: tuple[Problem, ...] = ()
    if _is_first_set(file, barcode_of_subject, start_s) and (
        barcode_of_subject.get(11),
        barcode_of_subject.get(17),
    ) == (18, 61):
        barcode_of_subject[11], barcode_of_subject[17] = 61, 18
        message = "barcodes of subjects 11 and 17, swapped in the table of data set 1: put right"
        problems = (Problem(message, 2),)
    return {float(barcode): subject for subject, barcode in barcode_of_subject.items()}, problems


def _is_first_set(file: Path, barcode_of_subject: dict[int, int], start_s: float) -> bool:
    """Data set 1 by its table, by the time of its recording, or by the name of the folder."""
    by_table = barcode_of_subject == FIRST_SET_BARCODES
    by_time = FIRST_SET_SPAN_S[0] <= start_s <= FIRST_SET_SPAN_S[1]
    by_name = re.search(r"dataset_?1$", file.resolve().parent.name, re.IGNORECASE) is not None
    return by_table or by_time or by_name


def _sightings(
    rows: Floats, subject_of_barcode: dict[float, int], landmark_subjects: list[int]
) -> tuple[Sightings, tuple[Problem, ...]]:
    identity_of_subject = {subject: index for index, subject in enumerate(landmark_subjects)}
    subject = np.array(
        [subject_of_barcode.get(barcode, -1) for barcode in rows[:, 1].tolist()], dtype=np.int64
    )
    identity: Ints = np.array([identity_of_subject.get(n, -1) for n in subject.tolist()], dtype=np.int64)
    kept = identity >= 0
    unknown, others = int(np.sum(subject == -1)), int(np.sum((subject != -1) & ~kept))
    sightings = Sightings(
        stamp_s=rows[kept, 0],
        range_m=rows[kept, 2],
        bearing_rad=rows[kept, 3],
        identity=identity[kept],
        class_index=np.full(int(kept.sum()), -1, dtype=np.int64),
        signature=np.full(int(kept.sum()), np.nan),
    )
    problems = (
        Problem("sightings of other robots: dropped", others),
        Problem("sightings of unknown barcodes: dropped", unknown),
    )
    return sightings, tuple(problem for problem in problems if problem.count)


def _truth_trajectory(files: RobotFiles) -> TruthTrajectory | None:
    if files.truth is not None:
        rows = read_table(files.truth, 4)
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) == 0:
            raise DataError("holds no pose without NaN or infinite values", files.truth)
        rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
        return TruthTrajectory(rows[:, 0], rows[:, 1:])
    averages = find_file(files.barcodes.parent / AVERAGES, f"Cleaned_Robot{files.number}_Groundtruth.csv")
    if averages is None:
        return None
    rows = read_table(averages, 4, delimiter=",", header_lines=1)
    unknown_heading = np.full(len(rows), np.nan)
    return TruthTrajectory(rows[:, 0], np.column_stack([rows[:, 1:3], unknown_heading]), heading_known=False)


def _config(truth: TruthTrajectory | None, start_s: float) -> dict[str, Any]:
    config: dict[str, Any] = {
        "motion": {
            "model": "velocity",
            "speed_std_m_per_s": 0.015,
            "lateral_std_m_per_s": 0.005,
            "yaw_rate_std_rad_per_s": 0.04,
            "noise_period_s": 1.0,
        },
        "sensor": {
            "model": "range_bearing",
            "range_std_m": 0.3,
            "bearing_std_rad": 0.06,
            "tail_degrees_of_freedom": 4.0,
            "field_of_view_rad": FIELD_OF_VIEW_RAD,
            "max_range_m": MAX_RANGE_M,
        },
        "filter": {
            "likelihood_exponent": 0.3,
            "rejuvenation": {"every_steps": 200, "spread": 0.5},
        },
        "association": ASSOCIATION,
    }
    if truth is not None and truth.heading_known:
        start = _pose_at(truth, start_s)
        config["initial_pose"] = {"x_m": start[0], "y_m": start[1], "heading_rad": start[2]}
    return config


def _pose_at(truth: TruthTrajectory, stamp_s: float) -> tuple[float, float, float]:
    x, y = (float(np.interp(stamp_s, truth.stamp_s, truth.T_world_robot[:, axis])) for axis in (0, 1))
    heading = np.interp(stamp_s, truth.stamp_s, np.unwrap(truth.T_world_robot[:, 2]))
    return x, y, float(wrap_to_pi(np.asarray(heading)))
