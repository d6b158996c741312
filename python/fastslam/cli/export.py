"""`fastslam export`: results in the formats of other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigError, DataError

if TYPE_CHECKING:
    from ..result import RunResult

_FORMATS = (".mcap", ".tum", ".geojson", ".csv")
_OF_LANDMARKS = {"map", "landmark", "landmarks"}
"""A word of these in the name of a table asks for the landmarks."""


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
    a .csv, for spreadsheets: stamp_s, x_m, y_m, heading_rad. A .csv with the word map or landmarks in its
    name holds the landmarks, unless --path is given. GeoJSON holds metres of the run's world, not
    longitude and latitude. A kept map is exported by `fastslam map export`.

    \b
    Examples:
      fastslam export results/latest drive.mcap
      fastslam export results/latest path.tum
      fastslam export results/latest path.csv --path live
      fastslam export results/latest trees_map.csv
      fastslam export results/latest map.geojson
    """
    if out.suffix not in _FORMATS:
        raise ConfigError(f"OUT: got {out}, expected a name that ends with {', '.join(_FORMATS)}")
    from ..resultfiles import read_result

    if path not in (None, "live", "smoothed"):
        raise ConfigError(f"--path: got {path}, expected live or smoothed")
    _refuse_a_map(results)
    result = read_result(results)
    typer.echo(f"{out}: {_written(result, out, path)}")


def _refuse_a_map(results: Path) -> None:
    """Errors: `DataError` for a map where results are meant, with the command for it."""
    if (results / "map.yaml").is_file() or (results.is_file() and results.suffix.lower() == ".csv"):
        raise DataError("is no folder of results; `fastslam map export` is for maps", results)


def _written(result: RunResult, out: Path, path: str | None) -> str:
    """Writes what the name of the file says, and says what it holds."""
    from ..resultfiles import to_json, write_atomically

    landmarks = f"{len(result.landmarks.ids):,} landmarks"
    if out.suffix == ".mcap":
        result.to_mcap(out)
        return f"{len(result.trajectory.stamp_s):,} poses, {landmarks}"
    if out.suffix == ".geojson":
        write_atomically(out, to_json(result.to_geojson(coordinates="local_metres")))
        return f"{landmarks} and the path, in metres"
    words = set(re.findall("[a-z]+", out.stem.lower()))
    if out.suffix == ".csv" and path is None and words & _OF_LANDMARKS:
        from ..mapfiles import exported

        chart = result.map
        write_atomically(out, exported(chart, "csv"))
        return f"{len(chart.role):,} landmarks; --path live or smoothed writes poses"
    chosen = result.path if path is None else result.trajectory if path == "live" else result.smoothed
    write_atomically(out, chosen.to_tum() if out.suffix == ".tum" else chosen.to_csv())
    return f"{len(chosen.stamp_s):,} poses"
