"""`--watch`: views of a run and of a stream, the page's server as a real process, and what it refuses."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
import pytest
from cli_runner import fastslam as command
from fastslam import watching
from fastslam.config import Config
from fastslam.log import Floats
from fastslam.watch_server import served
from fastslam.watching import History, Pace, View, Watcher, frame_of
from small_log import make_small_log, write_small_log

LOG = make_small_log(steps=120)


def all_views(config: dict[str, Any]) -> tuple[fastslam.RunResult, list[View]]:
    views: list[View] = []

    def watch(view: View) -> tuple[float, float]:
        views.append(view)
        return 0.0, 0.0

    return fastslam.run(LOG, config, watch=watch), views


@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
@pytest.mark.parametrize("mode", ["known", "unknown"])
def test_views_say_what_sightings_were_taken_for_and_change_nothing(algorithm: str, mode: str) -> None:
    config = {"algorithm": algorithm, "association": {"mode": mode}, "filter": {"particles": 20}}
    result, views = all_views(config)
    np.testing.assert_array_equal(
        result.trajectory.T_world_robot, fastslam.run(LOG, config).trajectory.T_world_robot
    )
    # One for each step, and one of the end.
    assert len(views) == len(result.steps.stamp_s) + 1
    seeing = [view for view in views if view.info.sightings]
    assert len(seeing) > 20
    for view in seeing:
        assert len(view.seen) == view.info.sightings == len(view.taken)
        assert int(view.founded.sum()) == view.info.new_landmarks
        assert set(view.taken) <= {*view.landmarks.ids, ""}
    assert seeing[0].founded.all() and not seeing[-1].founded.any()
    np.testing.assert_array_equal(views[-1].landmarks.mean_m, result.landmarks.mean_m)
    np.testing.assert_array_equal(views[-1].path.T_world_robot, result.smoothed.T_world_robot)
    check_places(seeing[-1])


def check_places(view: View) -> None:
    """Sightings are drawn where the landmarks are that they were taken for."""
    frame = frame_of(view, (0.0, 0.0, 0.0))
    assert len(frame["seen"]) == 6
    for x_m, y_m, row, founded in frame["seen"]:
        assert not founded and frame["id"][row] in view.landmarks.ids
        assert np.hypot(x_m - frame["xy"][2 * row], y_m - frame["xy"][2 * row + 1]) < 0.6
    assert all(isinstance(value, float) for value in frame["e"])


def test_sightings_are_drawn_from_where_the_sensor_stands() -> None:
    view = all_views({"filter": {"particles": 5}})[1][-1]
    x_m, y_m, heading_rad = view.T_world_robot.tolist()
    frame = frame_of(view, (1.0, 0.5, 0.3))
    expected = [
        x_m + np.cos(heading_rad) - 0.5 * np.sin(heading_rad),
        y_m + np.sin(heading_rad) + 0.5 * np.cos(heading_rad),
    ]
    np.testing.assert_allclose(frame["from"], expected, atol=1e-3)
    range_m, bearing_rad = view.seen[0]
    offset = np.array(frame["seen"][0][:2]) - frame["from"]
    assert np.hypot(*offset) == pytest.approx(range_m, abs=2e-3)
    turn = np.arctan2(offset[1], offset[0]) - heading_rad - 0.3 - bearing_rad
    assert np.cos(turn) == pytest.approx(1.0, abs=1e-5)


def test_history_is_bounded_and_keeps_the_newest_and_the_whole_time() -> None:
    history = History()
    for number in range(5000):
        history.add(b"x" * 10)
        assert history.frames[-1][0] == number
    assert watching.MOST_FRAMES / 2 <= len(history.frames) <= watching.MOST_FRAMES
    assert history.frames[0][0] < 100
    for _ in range(40):
        history.add(b"x" * 2_000_000)
    assert history.size_bytes == sum(len(frame) for _, frame in history.frames)
    assert history.size_bytes <= watching.MOST_BYTES
    newest = history.frames[-1][0]
    assert history.after(newest) == [] and history.after(newest - 3) == [history.frames[-1]]
    assert history.after(-1) == history.frames


class Page:
    """A browser of few words."""

    def __init__(self, address: str) -> None:
        parts = re.fullmatch(r"http://([\d.]+):(\d+)/", address)
        assert parts is not None
        host, port = parts.groups()
        self.host, self.port = host, int(port)
        self.connection = http.client.HTTPConnection(host, self.port, timeout=20)
        self.connection.request("GET", "/events")
        self.stream = self.connection.getresponse()

    def events(self) -> Iterator[tuple[str, Any]]:
        while (line := self.stream.readline()) != b"":
            if line.startswith(b"event: "):
                data = self.stream.readline().removeprefix(b"data: ")
                yield line[7:].decode().strip(), json.loads(data)

    def ask(
        self, path: str, body: object = None, *, headers: dict[str, str] | None = None
    ) -> tuple[int, bytes, dict[str, str]]:
        connection = http.client.HTTPConnection(self.host, self.port, timeout=20)
        sent = None if body is None else json.dumps(body)
        usual = {} if body is None else {"Content-Type": "application/json"}
        connection.request("GET" if body is None else "POST", path, sent, {**usual, **(headers or {})})
        answer = connection.getresponse()
        outcome = (answer.status, answer.read(), dict(answer.getheaders()))
        connection.close()
        return outcome

    def close(self) -> None:
        self.connection.close()
        self.stream.close()


@contextmanager
def program(*arguments: object, **streams: Any) -> Iterator[tuple[subprocess.Popen[str], Page]]:
    """A real process that is watched."""
    command = [sys.executable, "-m", "fastslam", *map(str, arguments), "--watch", "--watch-port", "0"]
    source = str(Path(fastslam.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": source, "NO_COLOR": "1"}
    with subprocess.Popen(
        command,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A shell's background jobs begin with this signal ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        **streams,
    ) as process:
        assert process.stderr is not None
        try:
            line = process.stderr.readline()
            assert line.startswith("watch: http://127.0.0.1:"), line + process.stderr.read()
            yield process, Page(line.removeprefix("watch: ").strip())
        finally:
            process.kill()


def test_a_page_holds_a_run_and_sees_it_to_its_end(tmp_path: Path) -> None:
    log, out = write_small_log(tmp_path / "log", steps=2000), tmp_path / "out"
    options = ("--no-auto", "--no-report", "--particles", 1000)
    with program("run", log, "--out", out, *options) as (process, page):
        assert page.ask("/pace", {"paused": True, "speed": 0})[0] == 200
        events = page.events()
        kind, scene = next(events)
        assert (kind, scene["name"], scene["kind"]) == ("scene", "circle", "run")
        before = [next(events)]
        while before[-1] != ("state", {"paused": True, "speed": 0.0, "ended": False}):
            before.append(next(events))
        # It stands: what asks to go on is all that makes it end.
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.3)
        assert page.ask("/pace", {"paused": False, "speed": 0})[0] == 200
        after = list(events)
        frames = [data for kind, data in (*before, *after) if kind == "frame"]
        assert after[-1] == ("state", {"paused": False, "speed": 0.0, "ended": True})
        output, errors = process.communicate(timeout=60)
        assert process.returncode == 0 and "ate_rmse_m" in output and "Traceback" not in errors
    assert frames[-1]["t"] == pytest.approx(200.0) and len(frames[-1]["id"]) == 6
    assert [frame["t"] for frame in frames] == sorted(frame["t"] for frame in frames)
    assert (out / "trajectory.tum").exists()


def test_a_page_that_closes_lets_the_run_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "GRACE_S", 0.1)
    watcher = Watcher("test", Config.resolve({}), kind="run")
    view = all_views({"filter": {"particles": 5}})[1][-1]
    watcher.enter()
    watcher.set_pace(Pace(paused=True))
    run = threading.Thread(target=watcher, args=(view,), daemon=True)
    run.start()
    run.join(0.3)
    assert run.is_alive(), "it is held"
    watcher.leave()
    run.join(10.0)
    assert not run.is_alive()


def test_ctrl_c_ends_a_run_that_is_held_and_keeps_what_there_is(tmp_path: Path) -> None:
    # Long enough not to be at its end before the page asks.
    log, out = write_small_log(tmp_path / "log", steps=20_000), tmp_path / "out"
    options = ("--no-auto", "--no-report", "--particles", 3000)
    with program("run", log, "--out", out, *options) as (process, page):
        page.ask("/pace", {"paused": True, "speed": 0})
        next(data for kind, data in page.events() if kind == "frame")
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 130 and "Traceback" not in errors, errors
        page.close()
    assert json.loads((out / "run.json").read_text())["interrupted"]


def test_a_stream_is_watched_and_nothing_holds_it(tmp_path: Path) -> None:
    rows = zip(LOG.controls.stamp_s.tolist(), LOG.controls.values.tolist(), strict=True)
    lines = [json.dumps({"t": stamp_s, "odom": values}) for stamp_s, values in rows]
    lines[5:5] = [json.dumps({"t": 0.45, "see": [[3.0, 0.2, "oak"], [4.0, -0.5, "elm"]]})]
    with program("live", stdin=subprocess.PIPE) as (process, page):
        assert process.stdin is not None
        assert page.ask("/pace", {"paused": True, "speed": 0})[0] == 404
        process.stdin.write("\n".join(lines[:20]) + "\n")
        process.stdin.flush()
        events = page.events()
        frame = next(data for kind, data in events if kind == "frame")
        assert sorted(frame["id"]) == ["elm", "oak"] and [entry[3] for entry in frame["seen"]] == [1, 1]
        _, errors = process.communicate("\n".join(lines[20:]) + "\n", timeout=60)
        assert (
            process.returncode == 0 and errors.startswith("health at the end: ") and "warning" not in errors
        )
        last = [data for kind, data in events if kind == "frame"][-1]
        assert last["t"] > frame["t"]


@pytest.fixture
def page() -> Iterator[Page]:
    with served(Watcher("test", Config.resolve({}), kind="run"), port=0) as address:
        opened = Page(address)
        yield opened
        opened.close()


def test_the_server_has_one_page_and_no_files(page: Page) -> None:
    status, body, headers = page.ask("/")
    assert status == 200 and b"<canvas" in body and b"http://" not in body and b"https://" not in body
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    paths = (
        "/watch.html",
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/events/",
        "/pace",
    )
    assert [page.ask(path)[0] for path in paths] == [404] * len(paths)


def test_the_server_refuses_other_sites(page: Page) -> None:
    here, body = f"127.0.0.1:{page.port}", {"paused": True, "speed": 1}
    for host in ("evil.example", f"evil.example:{page.port}", "127.0.0.1.evil.example", "", "[::2]"):
        assert page.ask("/", headers={"Host": host})[0] == 403, host
        assert page.ask("/events", headers={"Host": host})[0] == 403, host
    assert page.ask("/pace", body, headers={"Origin": "http://evil.example"})[0] == 403
    assert page.ask("/pace", body, headers={"Origin": "http://127.0.0.1:1"})[0] == 403
    assert page.ask("/pace", body, headers={"Content-Type": "text/plain"})[0] == 415
    assert page.ask("/pace", body, headers={"Origin": f"http://{here}"})[0] == 200
    assert page.ask("/", headers={"Host": f"localhost:{page.port}"})[0] == 200


@pytest.mark.parametrize(
    "asked",
    [[], {}, {"paused": 1, "speed": 1}, {"paused": True, "speed": -1}, {"paused": True, "speed": "1"},
     {"paused": True, "speed": float("nan")}, {"paused": True, "speed": 1, "more": 0}, "x" * 5000],
)  # fmt: skip
def test_a_pace_that_is_none_is_refused(page: Page, asked: object) -> None:
    assert page.ask("/pace", asked)[0] == 400


def test_a_port_in_use_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        outcome = command("live", "--watch", "--watch-port", port)
    outcome.assert_one_line_error(exit_code=2, contains=f"--watch-port: port {port} is in use")
    command("live", "--watch", "--watch-port", 70000).assert_one_line_error(exit_code=2, contains="70000")


def test_views_come_no_oftener_than_they_may_cost() -> None:
    watcher = Watcher("test", Config.resolve({}), kind="run")
    view = all_views({"filter": {"particles": 5}})[1][-1]
    assert watcher.is_due()
    wait_s, stamp_s = watcher(view)
    assert wait_s >= 0.9 * watching.FRAME_PERIOD_S and stamp_s == np.inf and not watcher.is_due()
    # A pace counts only while somebody watches.
    watcher.set_pace(Pace(paused=True))
    assert watcher(view)[1] == np.inf
    watcher.enter()
    watcher.set_pace(Pace(speed=2.0))
    assert watcher(view)[1] == pytest.approx(view.stamp_s + 2.0 * watching.FRAME_PERIOD_S)


def test_pages_hear_what_a_log_teaches() -> None:
    watcher = Watcher("test", Config.resolve({}), kind="run")
    _, version, state = watcher.news(-1, -1, wait_s=0.0)
    assert "learning" not in state
    passes = [{"name": "as stated", "state": "running", "landmarks": None, "nats": None, "told": []}]
    watcher.show_learning(passes)
    frames, later, state = watcher.news(-1, version, wait_s=5.0)
    assert (frames, state["learning"]) == ([], passes) and later != version
    ahead = {"sensor": {"mounting": {"x_m": 2.0}}}
    view = all_views({"filter": {"particles": 20}})[1][-1]
    watcher.configure(Config.resolve(ahead))
    watcher.show(view)
    shown = json.loads(watcher.news(-1, later, wait_s=0.0)[0][0][1])
    assert shown["from"] != shown["pose"][:2], "drawn from where the sensor was found to stand"


@pytest.mark.skipif("FASTSLAM_BROWSER" not in os.environ, reason="set FASTSLAM_BROWSER=chromium")
def test_a_browser_draws_it(tmp_path: Path) -> None:
    watcher = Watcher("test", Config.resolve({}), kind="run")
    watcher.show(all_views({"filter": {"particles": 20}})[1][-1])
    picture = tmp_path / "page.png"
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    options += ["--window-size=390,844", "--virtual-time-budget=2000", f"--screenshot={picture}"]
    with served(watcher, port=0) as address:
        watcher.end()
        subprocess.run(
            [os.environ["FASTSLAM_BROWSER"], *options, address], check=True, capture_output=True, timeout=60
        )
    assert colours(picture) >= {(42, 120, 184), (194, 65, 12)}, "the path and the robot"


def colours(picture: Path) -> set[tuple[int, ...]]:
    from matplotlib.image import imread

    pixels: Floats = np.round(255 * imread(picture)[..., :3]).astype(int)
    return {tuple(colour) for colour in np.unique(pixels.reshape(-1, 3), axis=0).tolist()}
