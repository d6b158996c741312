"""`fastslam export`: results in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigError

_FORMATS = (".mcap", ".tum", ".geojson", ".csv")


def export_results(
    results: Annotated[Path, typer.Argument(help="Folder of a run.", metavar="RESULTS")],
    out: Annotated[Path, typer.Argument(help="What to write: .mcap, .tum, .csv or .geojson.", metavar="OUT")],
    path: Annotated[
        str | None,
        typer.Option(
            metavar="live|smoothed", help="Which path a .tum or .csv holds; smoothed if there is one."
        ),
    ] = None,
) -> None:
    """Write results for other programs: a bag for viewers, the path alone, or map and path as GeoJSON.

    An .mcap holds messages of ROS 2 that viewers show: pose with covariance, transforms, path, and markers
    of the landmarks. A .tum file holds the smoothed path, and so does
    a .csv, for spreadsheets: stamp_s, x_m, y_m, heading_rad. GeoJSON holds metres of the run's world, not
    longitude and latitude.

    \b
    Examples:
      fastslam export results/latest drive.mcap
      fastslam export results/latest path.tum
      fastslam export results/latest path.csv --path live
      fastslam export results/latest map.geojson
    """
    if out.suffix not in _FORMATS:
        raise ConfigError(f"OUT: got {out}, expected a name that ends with {', '.join(_FORMATS)}")
    from ..resultfiles import read_result, to_json, write_atomically

    if path not in (None, "live", "smoothed"):
        raise ConfigError(f"--path: got {path}, expected live or smoothed")
    result = read_result(results)
    chosen = result.path if path is None else result.trajectory if path == "live" else result.smoothed
    if out.suffix == ".mcap":
        result.to_mcap(out)
        held = f"{len(result.trajectory.stamp_s):,} poses, {len(result.landmarks.ids):,} landmarks"
    elif out.suffix in (".tum", ".csv"):
        write_atomically(out, chosen.to_tum() if out.suffix == ".tum" else chosen.to_csv())
        held = f"{len(chosen.stamp_s):,} poses"
    else:
        write_atomically(out, to_json(result.to_geojson(coordinates="local_metres")))
        held = f"{len(result.landmarks.ids):,} landmarks and the path, in metres"
    typer.echo(f"{out}: {held}")
