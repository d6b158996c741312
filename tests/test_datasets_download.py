"""Downloads from a local server: checksums are verified and nothing partial is left behind."""

from __future__ import annotations

import gzip
import hashlib
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from fastslam.datasets import download as module
from fastslam.datasets import load
from fastslam.datasets.download import CatalogueEntry, RemoteFile, catalogue, download
from fastslam.errors import DataError

CONTENT = b"1 2 3\n" * 1000


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Keeps the test output clean."""


@pytest.fixture
def mirror(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder and the address under which it is served."""
    root = tmp_path / "mirror"
    root.mkdir()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(QuietHandler, directory=str(root)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield root, f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A catalogue of one log with one file."""
    file = RemoteFile("inner/a.txt", "http://invalid.invalid/a.txt", hashlib.sha256(CONTENT).hexdigest())
    entries = {"toy": CatalogueEntry("toy", "toy_folder", "http://invalid.invalid", (file,))}
    monkeypatch.setattr(module, "catalogue", lambda: entries)


def serve(root: Path, content: bytes) -> None:
    (root / "toy_folder" / "inner").mkdir(parents=True, exist_ok=True)
    (root / "toy_folder" / "inner" / "a.txt").write_bytes(content)


@pytest.mark.usefixtures("toy")
def test_file_is_fetched_once(mirror: tuple[Path, str], tmp_path: Path) -> None:
    root, url = mirror
    serve(root, CONTENT)
    folder = download("toy", tmp_path / "out", base_url=url)
    assert folder == tmp_path / "out" / "toy_folder"
    assert (folder / "inner" / "a.txt").read_bytes() == CONTENT
    serve(root, b"changed at the source")
    download("toy", tmp_path / "out", base_url=url)
    assert [path.name for path in folder.rglob("*") if path.is_file()] == ["a.txt"]


@pytest.mark.usefixtures("toy")
def test_wrong_content_is_refused_and_a_good_file_is_kept(mirror: tuple[Path, str], tmp_path: Path) -> None:
    root, url = mirror
    serve(root, CONTENT[:-1])
    with pytest.raises(DataError, match=r"SHA-256 [0-9a-f]{64}, expected [0-9a-f]{64}: not kept"):
        download("toy", tmp_path / "out", base_url=url)
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == []


@pytest.mark.usefixtures("toy")
def test_damaged_file_is_fetched_again(mirror: tuple[Path, str], tmp_path: Path) -> None:
    root, url = mirror
    serve(root, CONTENT)
    folder = download("toy", tmp_path / "out", base_url=url)
    (folder / "inner" / "a.txt").write_bytes(b"damaged")
    download("toy", tmp_path / "out", base_url=url)
    assert (folder / "inner" / "a.txt").read_bytes() == CONTENT


@pytest.mark.usefixtures("toy")
def test_missing_file_and_dead_server(mirror: tuple[Path, str], tmp_path: Path) -> None:
    _, url = mirror
    with pytest.raises(DataError, match=r"a\.txt could not be fetched \(HTTP status 404\)"):
        download("toy", tmp_path / "out", base_url=url)
    with pytest.raises(DataError, match=r"could not be fetched \("):
        download("toy", tmp_path / "out", base_url="http://127.0.0.1:1")
    with pytest.raises(DataError, match="expected an http or https address"):
        download("toy", tmp_path / "out", base_url=f"file://{tmp_path}")


def test_unknown_name_and_log_to_fetch_by_hand(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"unknown log utias_11, did you mean utias_\d\?; known: lost_in_the"):
        download("utias_11", tmp_path)
    with pytest.raises(DataError, match=r"utias_3 must be fetched by hand from http.* to .*MRCLAM_Dataset3"):
        download("utias_3", tmp_path)


@pytest.mark.slow
def test_catalogue_agrees_with_the_real_logs(
    data_dir: Path, mirror: tuple[Path, str], tmp_path: Path
) -> None:
    """What the catalogue's checksums accept is what the readers read."""
    root, url = mirror
    homes = {
        "lost_in_the_woods": data_dir / "lost_in_the_woods",
        "victoria_park": data_dir / "victoria_park" / "features_rfs_slam",
        "city_trees10000": data_dir / "city_trees10000",
        "freiburg": data_dir / "freiburg_slam_course",
        "utias_1": data_dir / "utias_mrclam" / "MRCLAM_Dataset1",
    }
    for name, home in homes.items():
        for file in catalogue()[name].files:
            target = root / catalogue()[name].folder / file.path
            target.parent.mkdir(parents=True, exist_ok=True)
            plain, packed = home / file.path, home / f"{file.path}.gz"
            target.write_bytes(plain.read_bytes() if plain.exists() else gzip.decompress(packed.read_bytes()))
        log = load(download(name, tmp_path / "out", base_url=url))
        assert len(log.sightings.stamp_s) == len(load(home).sightings.stamp_s)
    assert len(list((tmp_path / "out").iterdir())) == len(homes)
