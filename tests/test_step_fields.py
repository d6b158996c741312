"""What crosses of a step is listed once, in the compiled module; everything in Python follows that list."""

from __future__ import annotations

import csv
import re
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import numpy as np
from conftest import ROOT
from fastslam import FastSlam, StepInfo, _core, run
from fastslam.result import StepFields, Steps
from fastslam.resultfiles import read_result, write_result
from small_log import make_small_log

TYPE_OF_KIND = {
    "number": "Number",
    "count": "Count",
    "flag": "Flag",
    "status": "Status",
    "reasons": "Reasons",
}
OF_ONE_STEP = {"number": float, "count": int, "flag": bool, "status": str, "reasons": tuple}
OF_MANY = {"number": "f", "count": "i", "flag": "b", "status": "i", "reasons": "i"}


def test_the_typed_fields_are_those_of_the_core() -> None:
    listed = _core.step_fields()
    assert len(listed) >= 22
    assert [(field.name, field.type) for field in fields(StepFields)] == [
        (name, TYPE_OF_KIND[kind]) for name, kind in listed
    ]
    assert all(isinstance(parameter, TypeVar) for parameter in StepFields.__parameters__)
    names = [name for name, _ in listed]
    assert [field.name for field in fields(StepInfo)] == [*names, "warnings"]
    assert [field.name for field in fields(Steps)] == [*names, "stamp_s", "latency_us"]


def test_the_documentation_lists_every_field() -> None:
    page = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \| \S", page, re.M)
    assert listed == [name for name, _ in _core.step_fields()] and len(listed) >= 22


def test_one_step_has_a_value_of_its_kind_for_every_field() -> None:
    robot = FastSlam({"filter": {"particles": 20}})
    info = robot.step([1.0, 0.1], dt_s=0.1, range_m=[3.0, 5.0], bearing_rad=[0.3, -0.4], identity=["a", None])
    for name, kind in _core.step_fields():
        assert type(getattr(info, name)) is OF_ONE_STEP[kind], name
    assert (info.step, info.sightings, info.new_landmarks, info.sampled) == (0, 2, 2, True)
    assert info.nis_band == (info.nis_band_low, info.nis_band_high)


def test_a_run_has_an_array_for_every_field_and_the_file_a_column(tmp_path: Path) -> None:
    log = make_small_log(steps=80)
    result = run(log, {"filter": {"particles": 20}})
    count = len(result.steps.stamp_s)
    assert count >= 16
    for name, kind in _core.step_fields():
        column = getattr(result.steps, name)
        assert column.shape == (count,) and column.dtype.kind == OF_MANY[kind], name
    np.testing.assert_array_equal(result.steps.step, np.arange(count))
    assert result.steps.sampled.any()
    write_result(result, log, tmp_path)
    with (tmp_path / "steps.csv").open(newline="") as file:
        header = next(csv.reader(file))
    assert header == ["stamp_s", "latency_us", *(name for name, _ in _core.step_fields())]
    back = read_result(tmp_path).steps
    for name in header:
        np.testing.assert_allclose(getattr(back, name), getattr(result.steps, name), rtol=1e-8, err_msg=name)


def test_steps_of_an_older_version_are_read_with_what_they_lack_marked(tmp_path: Path) -> None:
    log = make_small_log(steps=40)
    write_result(run(log, {"filter": {"particles": 10}}), log, tmp_path)
    path = tmp_path / "steps.csv"
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    older = [name for name in rows[0] if name not in ("merged", "nis_band_low", "sampled")]
    lines = [",".join(row[name] for name in older) for row in rows]
    path.write_text("\n".join([",".join(older), *lines]) + "\n")
    steps = read_result(tmp_path).steps
    assert (steps.merged == -1).all() and np.isnan(steps.nis_band_low).all() and not steps.sampled.any()
    np.testing.assert_array_equal(steps.sightings, [int(row["sightings"]) for row in rows])
