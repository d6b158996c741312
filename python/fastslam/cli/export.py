"""`fastslam export`: results in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigError

_FORMATS = (".mcap", ".tum", ".geojson")


def export_results(
    results: Annotated[Path, typer.Argument(help="Folder of a run.", metavar="RESULTS")],
    out: Annotated[Path, typer.Argument(help="What to write: .mcap, .tum or .geojson.", metavar="OUT")],
) -> None:
    """Write results for other programs: a bag for viewers, the path alone, or map and path as GeoJSON.

    An .mcap holds messages of ROS 2 that viewers show: pose with covariance, transforms, path, and markers
    of the landmarks. A .tum file holds the smoothed path. GeoJSON holds metres of the run's world, not
    longitude and latitude.

    \b
    Examples:
      fastslam export results/latest drive.mcap
      fastslam export results/latest path.tum
      fastslam export results/latest map.geojson
    """
    if out.suffix not in _FORMATS:
        raise ConfigError(f"OUT: got {out}, expected a name that ends with {', '.join(_FORMATS)}")
    from ..resultfiles import read_result, to_json, write_atomically

    result = read_result(results)
    if out.suffix == ".mcap":
        result.to_mcap(out)
        held = f"{len(result.trajectory.stamp_s):,} poses, {len(result.landmarks.ids):,} landmarks"
    elif out.suffix == ".tum":
        write_atomically(out, result.path.to_tum())
        held = f"{len(result.path.stamp_s):,} poses"
    else:
        write_atomically(out, to_json(result.to_geojson(coordinates="local_metres")))
        held = f"{len(result.landmarks.ids):,} landmarks and the path, in metres"
    typer.echo(f"{out}: {held}")
