"""`fastslam map`: look at maps that are kept, check, draw, edit, compare, join and export them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ConfigError
from .console import make_table, stdout
from .encoding import print_json
from .options import Json

if TYPE_CHECKING:
    from ..mapmerge import Part

app = typer.Typer()

MapPath = Annotated[Path, typer.Argument(help="Map: a folder, or a table of landmarks.", metavar="MAP")]
Landmarks = Annotated[list[str] | None, typer.Option(metavar="ID,ID", help="Landmarks that are taken out.")]


@app.command("info", short_help="Say what is in a map.")
def map_info(path: MapPath, json: Json = False) -> None:
    """Say what is in a map: landmarks by role and class, extent, how well they are known.

    \b
    Examples:
      fastslam map info yard.map
    """
    from ..maps import Map, facts

    found = facts(Map.load(path))
    if json:
        print_json(found)
        return
    rows = [(name, _shown(value), unit) for name, (value, unit) in found.items()]
    stdout().print(make_table(str(path), ("quantity", ">value", "unit"), rows))


@app.command("check", short_help="Check a map; faults are told with file and line.")
def map_check(path: MapPath) -> None:
    """Check a map and say what is wrong with it, or odd: two landmarks at one place, or one a kilometre off.

    \b
    Examples:
      fastslam map check yard.map
    """
    from ..maps import Map, oddities

    chart = Map.load(path)
    lines = oddities(chart)
    for line in lines:
        typer.echo(f"odd: {line}")
    typer.echo(f"{path}: {len(chart.role):,} landmarks, {len(lines)} odd" if lines else f"{path}: sound")


@app.command("draw", short_help="Draw a map as a picture.")
def map_draw(
    path: MapPath,
    out: Annotated[Path, typer.Option(help="The picture; its ending says which kind.")] = Path("map.png"),
) -> None:
    """Draw the landmarks with ellipses of 2σ in the colours of their classes; fixed ones are squares.

    \b
    Examples:
      fastslam map draw yard.map --out yard.png
    """
    from ..maps import Map
    from ..plots.chart import write_chart

    typer.echo(write_chart(Map.load(path), out))


@app.command("edit", short_help="Change a map: remove, merge, move, name, fix, free.")
def map_edit(
    path: MapPath,
    remove: Landmarks = None,
    merge: Annotated[
        list[str] | None, typer.Option(metavar="A,B", help="Landmarks that are one; A keeps its id.")
    ] = None,
    move: Annotated[
        list[str] | None, typer.Option(metavar="ID=X,Y", help="A landmark's place, metres.")
    ] = None,
    name: Annotated[list[str] | None, typer.Option(metavar="ID=NAME", help="A landmark's new id.")] = None,
    fix: Annotated[list[str] | None, typer.Option(metavar="ID,ID", help="Landmarks that stay.")] = None,
    free: Annotated[
        list[str] | None, typer.Option(metavar="ID,ID", help="Landmarks that may improve.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the changed map; MAP itself by default.")
    ] = None,
) -> None:
    """Change a map: all changes or none, in the order remove, merge, move, fix, free, name.

    \b
    Examples:
      fastslam map edit yard.map --remove L12 --merge L3,L9 --move L4=3.2,1.1
      fastslam map edit yard.map --name L7=gate --fix L7 --out yard-2.map
    """
    from ..mapedit import Edits, edited
    from ..maps import Map

    chart = Map.load(path)
    edits = Edits.parse(remove=remove, merge=merge, move=move, name=name, fix=fix, free=free)
    changed = edited(chart, edits)
    target = changed.save(out if out is not None else path if path.is_dir() else path.with_suffix(".map"))
    typer.echo(f"{target}: {len(changed.role):,} landmarks, {len(chart.role):,} before")


@app.command("diff", short_help="Say what differs between two maps.")
def map_diff(
    first: MapPath,
    second: Annotated[Path, typer.Argument(help="The other map, in the same frame.", metavar="OTHER")],
    gate_m: Annotated[float, typer.Option(min=0.0, help="Within this distance two are one.")] = 1.0,
    json: Json = False,
) -> None:
    """Say which landmarks of the second map are new, gone, moved or edited against the first.

    Edited: another name, role or note.

    \b
    Examples:
      fastslam map diff monday.map tuesday.map
    """
    from ..maps import Map, difference

    found = difference(Map.load(first), Map.load(second), gate_m=gate_m)
    if json:
        print_json(found)
        return
    rows = [(ours, theirs, f"{off_m:.3f}") for ours, theirs, off_m in found["moved"]]
    rows += [
        (ours, theirs, f"{what}: {was or '-'} -> {now or '-'}")
        for ours, theirs, what, was, now in found["changed"]
    ]
    rows += [(name, "", "gone") for name in found["gone"]]
    rows += [("", name, "new") for name in found["new"]]
    title = f"{found['common']:,} in common, {found['rms_m']:.3f} m apart (RMS)"
    stdout().print(make_table(title, (first.name, second.name, ">moved (m), or what changed"), rows))


@app.command("merge", short_help="Join maps of several robots or days; nobody says how they lie.")
def map_merge(
    paths: Annotated[
        list[Path], typer.Argument(help="Maps: folders, or tables of landmarks.", metavar="MAP...")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the map.")] = Path("merged.map"),
    json: Json = False,
) -> None:
    """Join maps in the frame of the first. How they lie on each other is found from the landmarks alone.

    Where that is not sure nothing is written, and the exit code is 1.

    \b
    Examples:
      fastslam map merge monday.map tuesday.map --out yard.map
    """
    from ..mapmerge import facts
    from ..maps import merge

    merged = merge(list(paths))
    merged.map.save(out)
    if json:
        print_json(facts(merged))
        return
    rows = [_place(part) for part in merged.parts]
    stdout().print(make_table(f"{out}: {len(merged.map.role):,} landmarks", _PLACE, rows))


@app.command("align", short_help="Bring a map into the frame of another one.")
def map_align(
    path: MapPath,
    onto: Annotated[Path, typer.Argument(help="The map, or survey, whose frame is wanted.", metavar="ONTO")],
    out: Annotated[Path | None, typer.Option(help="Folder for the map in that frame.")] = None,
    json: Json = False,
) -> None:
    """Find how a map lies on another one, from the landmarks alone, and move it there.

    Where that is not sure nothing is written, and the exit code is 1.

    \b
    Examples:
      fastslam map align yard.map survey.csv --out surveyed.map
    """
    from ..mapmerge import part_facts
    from ..maps import Map, align

    aligned, part = align(Map.load(path), Map.load(onto))
    if out is not None:
        aligned.save(out)
    if json:
        print_json(part_facts(part))
        return
    stdout().print(make_table(f"{path} in the frame of {onto}", _PLACE, [_place(part)]))


_PLACE = ("map", ">x (m)", ">y (m)", ">heading (rad)", ">in common", ">apart, RMS (m)")


def _place(part: Part) -> tuple[str, ...]:
    return (
        part.name,
        *(f"{value:.3f}" for value in part.T_map_part),
        f"{part.pairs:,}",
        f"{part.rms_m:.3f}",
    )


@app.command("export", short_help="Write a map as CSV, GeoJSON or g2o.")
def map_export(
    path: MapPath,
    to: Annotated[str, typer.Option(metavar="csv|geojson|g2o", help="The format.")] = "csv",
    out: Annotated[Path | None, typer.Option(help="The file; MAP.FORMAT by default.")] = None,
) -> None:
    """Write a map for other programs. GeoJSON has x and y in metres in the map's frame, not degrees.

    \b
    Examples:
      fastslam map export yard.map --to geojson
    """
    from ..mapfiles import exported
    from ..maps import Map
    from ..resultfiles import write_atomically

    text = exported(Map.load(path), to)
    stem = path.name.removesuffix(".map") if path.is_dir() else path.stem
    target = out if out is not None else Path(f"{stem}.{to}")
    if target.exists() and target.samefile(path):
        raise ConfigError(f"--out: {target} is the map itself, name another file")
    typer.echo(write_atomically(target, text))


def _shown(value: Any) -> str:
    return "" if value is None else f"{value:,}" if isinstance(value, int | float) else str(value)
