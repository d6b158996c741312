"""`fastslam detect`: a laser scan, or all scans of a log, with what is detected in them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import ConfigError, DataError
from .options import ConfigFile, Format, LogPath, Robot, Run, Settings


def detect_landmarks(
    path: LogPath,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    config: ConfigFile = None,
    settings: Settings = None,
    scan: Annotated[int, typer.Option(min=0, metavar="N", help="Which scan to draw, from 0.")] = 0,
    out: Annotated[Path, typer.Option(help="PNG file of that scan.")] = Path("scan.png"),
    html: Annotated[
        Path | None, typer.Option(help="Instead: an HTML page with a slider over all scans.", metavar="FILE")
    ] = None,
) -> None:
    """Detect landmarks in the laser scans of a log, and draw one scan or all with what was found.

    Colours and labels say why a piece of a scan is no landmark: too few beams, too wide, hidden, a poor fit.

    Settings come from: defaults < those of the log's scans < --config < --set (keys in docs/detectors.md).
    Of a file for `fastslam run` the section `detector` counts.

    \b
    Examples:
      fastslam detect LOG --scan 120 --out scan.png
      fastslam detect LOG --html scans.html
      fastslam detect LOG --scan 120 --set kind=corners
    """
    from ..datasets.registry import load
    from ..detection import SCHEMA, find
    from ..plots.scan import write_scan_figure, write_scan_page

    layers = (_from_file(config) if config is not None else {}, SCHEMA.parse_assignments(settings or []))
    log = load(path, format=format, robot=robot, run=run)
    if log.scans is None:
        raise DataError("the log holds no laser scans to detect landmarks in", path)
    overrides = SCHEMA.merge(*layers)
    found = find(log.scans, SCHEMA.merge(log.scans.detector, overrides))
    if html is not None:
        written = write_scan_page(log, html, config=overrides)
    else:
        written = write_scan_figure(log, out, scan=scan, config=overrides)
    typer.echo(f"{len(found.stamp_s):,} detections in {len(log.scans.stamp_s):,} scans")
    typer.echo(written)


def _from_file(path: Path) -> dict[str, Any]:
    """Settings of the detector: the file's or, where it is one of a run, those of its section `detector`."""
    from ..config import detector_of, load_config
    from ..detection import SCHEMA

    try:
        return SCHEMA.load(path)
    except ConfigError:
        with suppress(ConfigError):
            if section := detector_of(load_config(path)):
                return section
        raise
