"""Fetches public logs from where they are published and checks every byte against a known checksum."""

from __future__ import annotations

import difflib
import functools
import hashlib
import http.client
import json
import os
import urllib.error
import urllib.request
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from urllib.parse import urlsplit

from ..errors import DataError

TIMEOUT_S = 60.0
CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class RemoteFile:
    """One file: its path below the log's folder, its address and the SHA-256 of its content."""

    path: str
    url: str
    sha256: str


@dataclass(frozen=True)
class CatalogueEntry:
    """One public log. Without `files` it must be fetched by hand from `home`."""

    name: str
    folder: str
    """Name of the folder that the files go to; readers may rely on it."""
    home: str
    files: tuple[RemoteFile, ...]


@functools.cache
def catalogue() -> dict[str, CatalogueEntry]:
    """The known public logs by name."""
    text = resources.files(__package__).joinpath("catalogue.json").read_text(encoding="utf-8")
    return {
        name: CatalogueEntry(
            name, entry["folder"], entry["home"], tuple(RemoteFile(**file) for file in entry["files"])
        )
        for name, entry in json.loads(text).items()
    }


def download(name: str, folder: Path | str, *, base_url: str | None = None) -> Path:
    """Fetch a log of the catalogue into a folder below `folder` and return the path to give to `load`.

    `base_url` names a mirror that holds `<log folder>/<file>` instead of the public address. Files that are
    there already with the right checksum are kept. Errors: DataError for an unknown name, a log that must be
    fetched by hand, a failed transfer or content with another checksum; no partial file is left.
    """
    entry = _entry(name, folder)
    target = Path(folder) / entry.folder
    for file in entry.files:
        url = file.url if base_url is None else f"{base_url.rstrip('/')}/{entry.folder}/{file.path}"
        path = target / file.path
        if not (path.is_file() and _sha256(path) == file.sha256):
            path.parent.mkdir(parents=True, exist_ok=True)
            _fetch(url, path, file.sha256)
    return target


def _entry(name: str, folder: Path | str) -> CatalogueEntry:
    entry = catalogue().get(name)
    if entry is None:
        near = difflib.get_close_matches(name, catalogue(), n=1)
        hint = f", did you mean {near[0]}?" if near else ""
        raise DataError(f"unknown log {name}{hint}; known: {', '.join(catalogue())}")
    if not entry.files:
        target = Path(folder) / entry.folder
        raise DataError(f"{name} must be fetched by hand from {entry.home} and unpacked to {target}")
    return entry


def _fetch(url: str, path: Path, sha256: str) -> None:
    if urlsplit(url).scheme not in ("http", "https"):
        raise DataError(f"{url}: expected an http or https address")
    temporary = path.with_name(f".{path.name}.part")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as response, temporary.open("wb") as out:
            while chunk := response.read(CHUNK_BYTES):
                out.write(chunk)
        got = _sha256(temporary)
        if got != sha256:
            raise DataError(f"content of {url} has SHA-256 {got}, expected {sha256}: not kept", path)
        os.replace(temporary, path)
    except urllib.error.HTTPError as error:
        raise DataError(f"{url} could not be fetched (HTTP status {error.code})") from error
    except (OSError, http.client.HTTPException) as error:
        raise DataError(f"{url} could not be fetched ({getattr(error, 'reason', error)})") from error
    finally:
        temporary.unlink(missing_ok=True)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()
