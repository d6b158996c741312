"""Configurations: layers, checks that name the key, and the schema's explanations."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from fastslam import FastSlam, run, run_many
from fastslam.config import Config, explain, load_config, merge, parse_assignments, schema, sensor_of
from fastslam.detection import configure_detector
from fastslam.errors import ConfigError
from fastslam.limits import OF_SETTINGS
from fastslam.opinion import run_by_need
from fastslam.robot import Robot
from fastslam.simulation import simulate
from fastslam.tuning.doctor import diagnose


def message_of(action: Callable[[], Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    return message


def write(folder: Path, text: str) -> Path:
    path = folder / "settings.yaml"
    path.write_text(text)
    return path


def test_later_layers_win_and_others_stay() -> None:
    log_settings = {"filter": {"particles": 7}, "seed": 3}
    config = Config.resolve(log_settings, {"filter": {"particles": 11}}, parse_assignments(["seed=5"]))
    assert config["filter"]["particles"] == 11
    assert config["seed"] == 5
    assert config["filter"]["resampling"] == Config.resolve()["filter"]["resampling"]


def test_a_file_is_a_layer_by_its_path(tmp_path: Path) -> None:
    path = write(tmp_path, "filter:\n  particles: 7\nseed: 3\n")
    for layer in (path, str(path)):
        config = Config.resolve({"filter": {"particles": 5}}, layer, {"seed": 4})
        assert (config["filter"]["particles"], config["seed"]) == (7, 4)
        assert merge(layer, {"seed": 4}) == {"filter": {"particles": 7}, "seed": 4}
    assert "nothing.yaml" in message_of(partial(Config.resolve, tmp_path / "nothing.yaml"))
    wrong = write(tmp_path, "filter:\n  partikles: 7\n")
    assert message_of(partial(Config.resolve, wrong)).startswith(f"{wrong}:2: filter.partikles: unknown key")


def test_runs_take_a_file_of_settings(tmp_path: Path) -> None:
    path = write(tmp_path, "filter:\n  particles: 7\n")
    log = simulate({"seed": 1, "world": {"count": 20}, "max_duration_s": 5.0})
    results = [run(log, path), *run_many(log, str(path), seeds=[2]), run_by_need(log, path)]
    assert [result.config["filter"]["particles"] for result in results] == [7, 7, 7]
    assert diagnose(log, path).questions == diagnose(log).questions


def test_merge_leaves_its_arguments_alone() -> None:
    below: dict[str, Any] = {"filter": {"particles": 1}}
    merged = merge(below, {"filter": {"particles": 2}})
    assert (below["filter"]["particles"], merged["filter"]["particles"]) == (1, 2)


def test_another_motion_model_takes_no_parameters_from_the_first() -> None:
    kinds = [info for info in explain("motion") if info.name == "motion.model"]
    assert len(kinds) == 1
    models = kinds[0].type.split(" | ")
    assert len(models) >= 3
    for model in models:
        config = Config.resolve({"motion": {"model": model}})
        assert config["motion"]["model"] == model


def test_key_of_another_model_is_refused_by_name() -> None:
    model = Config.resolve()["motion"]["model"]
    foreign = [info for info in explain("motion") if info.only_for and model not in info.only_for]
    own = {info.name for info in explain("motion") if model in info.only_for}
    foreign = [info for info in foreign if info.name not in own]
    assert foreign
    message = message_of(lambda: Config.resolve(parse_assignments([f"{foreign[0].name}=0.5"])))
    assert message.startswith(f"{foreign[0].name}: only for model = ")


def test_a_sensor_has_the_keys_of_its_model_and_reads_those_of_others() -> None:
    keys = {info.name.rpartition(".")[2]: info.only_for for info in explain("sensor")}
    counted = 0
    for model in ("range_bearing", "range", "bearing", "own"):
        layer = {"model": model, "range_std_m": 0.3, "bearing_std_rad": 0.04, "mounting": {"x_m": 0.5}}
        sensor = Config.resolve({"sensor": layer})["sensor"]
        for key, value in layer.items():
            assert key in sensor or model not in keys[key].split(), key
            if key != "mounting" and key in sensor:
                assert sensor[key] == value
        assert not [key for key in sensor if keys.get(key) and model not in keys[key].split()]
        assert Config.resolve({"sensor": sensor})["sensor"] == sensor
        whole = sensor_of({"sensor": sensor})
        assert whole.keys() >= Config.resolve()["sensor"].keys() and whole["mounting"]["x_m"] == 0.5
        counted += len(sensor)
    assert counted > 30
    # A model alone leaves the rest of the section as it is.
    layers = {"sensor": {"max_range_m": 7.0, "bearing_std_rad": 0.5}}, {"sensor": {"model": "range"}}
    sensor = Config.resolve(*layers)["sensor"]
    assert sensor["max_range_m"] == 7.0 and "bearing_std_rad" not in sensor


def test_dump_reads_back_and_explains_every_key(tmp_path: Path) -> None:
    config = Config.resolve({"seed": 42})
    text = config.dump()
    assert Config.resolve(load_config(write(tmp_path, text))) == config
    lines = text.splitlines()
    keys = [number for number, line in enumerate(lines) if not line.lstrip().startswith("#")]
    assert len(keys) > 15
    for number in keys:
        assert lines[number - 1].lstrip().startswith("# "), f"no description above: {lines[number]}"


def test_every_key_is_explained_and_its_default_is_what_the_core_fills_in() -> None:
    keys = explain()
    assert len(keys) > 15
    defaults = Config.resolve()
    checked = 0
    for info in keys:
        assert info.type, info.name
        value: Any = defaults
        for part in info.name.split("."):
            value = value.get(part) if hasattr(value, "get") else None
        section = defaults.get(info.name.partition(".")[0])
        if value is not None and not (info.only_for and section["model"] not in info.only_for):
            assert info.default == value, info.name
            checked += 1
    assert checked > 10


def test_every_number_has_a_bound_and_one_beyond_it_is_refused_by_name() -> None:
    refused = 0
    for info in explain():
        if not info.type.startswith("number"):
            continue
        unit = next((unit for unit in sorted(OF_SETTINGS, key=len)[::-1] if info.name.endswith(unit)), "")
        most = OF_SETTINGS["position" if info.name in ("initial_pose.x_m", "initial_pose.y_m") else unit]
        layer: dict[str, Any] = {"association": {"classes": {}, "signatures": {}}}
        if info.only_for:
            layer = merge(layer, {info.name.partition(".")[0]: {"model": info.only_for.split()[2]}})
        for value in (1.001 * most, 1e300, float("nan")):
            wrong: Any = value
            for part in reversed(info.name.split(".")):
                wrong = {part: wrong}
            message = message_of(partial(Config.resolve, layer, wrong))
            assert message.startswith(f"{info.name}: "), message
        refused += 1
    assert refused > 60


def test_explain_of_a_section_lists_only_it() -> None:
    names = [info.name for info in explain("filter.resampling")]
    assert names and all(name.startswith("filter.resampling.") for name in names)


def test_schema_is_draft_2020_12_and_closed() -> None:
    assert schema()["$schema"].endswith("2020-12/schema")
    assert schema()["additionalProperties"] is False


@pytest.mark.parametrize(
    ("assignment", "start", "hint"),
    [
        ("filter.particels=3", "filter.particels: unknown key", "filter.particles"),
        ("particles=3", "particles: unknown key", "filter.particles"),
        ("zzz=3", "zzz: unknown key", "config explain"),
        ("seed", "seed: expected key=value", "filter.particles=100"),
        ("filter.particles=0", "filter.particles: ", "0"),
        ("filter.particles=many", "filter.particles: ", "many"),
        ("filter.particles=-3", "filter.particles: ", "-3"),
        ("filter.resampling.threshold=.nan", "filter.resampling.threshold: must be a finite", "nan"),
        ("filter.resampling.threshold=2020-01-01", "filter.resampling.threshold: expected", "date"),
        ("sensor.range_std_m=0", "sensor.range_std_m: ", "0"),
        ("sensor.range_std_m=-1", "sensor.range_std_m: ", "-1"),
        ("motion.model=hover", "motion.model: ", "velocity"),
        ("filter.particles=[3", "filter.particles:", "]"),
    ],
)
def test_bad_assignment_names_the_key(assignment: str, start: str, hint: str) -> None:
    message = message_of(lambda: Config.resolve(parse_assignments([assignment])))
    assert message.startswith(start)
    assert hint in message


def test_number_with_exponent_and_no_point_is_a_number() -> None:
    assert parse_assignments(["sensor.range_std_m=1e-3"]) == {"sensor": {"range_std_m": 0.001}}


def test_unknown_key_in_a_mapping_is_refused_too() -> None:
    message = message_of(lambda: Config.resolve({"filter": {"partikles": 1}}))
    assert message.startswith("filter.partikles: unknown key")


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("filter:\n  particles: 3\n  particels: 4\n", 3, "did you mean filter.particles?"),
        ("filter:\n  particles: 3\nseed: 1\nfilter:\n  particles: 4\n", 4, "duplicate key, first given"),
        ("seed: 1\nfilter:\n  particles: [3\n", 4, "expected"),
        ("seed: 1\nfilter: {particles: 3}}\n", 2, "expected"),
        ("- 1\n- 2\n", 1, "section"),
        ("\tseed: 1\n", 1, "cannot start any token"),
    ],
)
def test_bad_file_names_the_line(tmp_path: Path, text: str, line: int, part: str) -> None:
    path = write(tmp_path, text)
    message = message_of(lambda: load_config(path))
    assert message.startswith(f"{path}:{line}: ")
    assert part in message


def test_missing_folder_and_binary_files_are_one_line_errors(tmp_path: Path) -> None:
    assert "does not exist" in message_of(lambda: load_config(tmp_path / "none.yaml"))
    assert "directory" in message_of(lambda: load_config(tmp_path))
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"seed: \xff\xfe")
    assert "not UTF-8" in message_of(lambda: load_config(binary))


def test_empty_file_is_an_empty_layer(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, "# nothing\n")) == {}


def test_dump_is_plain_yaml() -> None:
    config = Config.resolve()
    assert yaml.safe_load(config.dump()) == dict(config)


@pytest.mark.parametrize("key", ["trunks.range_std_m", "corners.min_beams"])
def test_a_setting_of_the_detector_is_called_one(key: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{re.escape(key)}: is a setting of the detector: detector\."):
        parse_assignments([f"{key}=1"])
    with pytest.raises(ConfigError, match=r"unknown key; did you mean trunks\.range_std_m"):
        configure_detector({"trunks": {"range_std": 1}})


def test_a_section_of_the_detector_is_checked_where_it_is_written(tmp_path: Path) -> None:
    path = write(tmp_path, "detector:\n  kind: trunks\n  trunks:\n    max_range: 3\n")
    expected = r":4: detector\.trunks\.max_range: unknown key; did you mean trunks\.max_range_m"
    with pytest.raises(ConfigError, match=expected):
        load_config(path)
    good = write(tmp_path, "detector:\n  trunks:\n    max_range_m: 3\n")
    layer = merge(load_config(good), parse_assignments(["detector.trunks.min_beams=2"]))
    config = Config.resolve(layer)
    assert config["detector"] == {"trunks": {"max_range_m": 3, "min_beams": 2}}
    assert "detector" not in json.loads(config.to_json()) and "detector" not in Config.resolve()
    assert Config.resolve(yaml.safe_load(config.dump())) == config
    with pytest.raises(ConfigError, match=r"^detector\.trunks\.max_range_m: "):
        Config.resolve({"detector": {"trunks": {"max_range_m": -1.0}}})
    with pytest.raises(ConfigError, match=r"^detector: got 3, expected settings such as"):
        Config.resolve({"detector": 3})
    assert [info.name for info in explain("detector.trunks.max_range_m")] == ["trunks.max_range_m"]
    with pytest.raises(ConfigError, match="FastSlam takes sightings"):
        FastSlam(layer)
    with pytest.raises(ConfigError, match="only for turns of a laser"):
        Robot(layer)
