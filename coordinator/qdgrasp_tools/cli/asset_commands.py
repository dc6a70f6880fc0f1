"""`qdgrasp asset` and `object`: list and fetch assets, check and repair meshes.

Also how these and `qdgrasp gripper` print what a check found, and where they draw pictures.
"""

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_assets import catalog, ycb
from qdgrasp_assets.asset_paths import named_path
from qdgrasp_assets.asset_report import AssetReport, inspect_object
from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.mesh_io import WRITABLE_FORMATS, scale_in_words, to_bytes
from qdgrasp_assets.grippers.gripper import Gripper
from qdgrasp_assets.object_model import ObjectModel, file_facts, geometry_of, read_draft
from qdgrasp_assets.object_shape import is_in_catalog
from qdgrasp_assets.ycb import YCB_HOME, YCB_TERMS, WrongScan, fetch_scan
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import RunSpec, run_spec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.cli import options
from qdgrasp_tools.local.progress import progress_messages


def print_findings(found: AssetReport, *, as_json: bool = False) -> None:
    """Print a report as a table or as JSON."""
    echo(json.dumps(found.values) if as_json else found.table)


def refuse_faulty(kind: str, found: AssetReport, why: str = "cannot be used as it is") -> None:
    """Raise AssetError for an asset with faults; they are printed already."""
    if found.faults:
        count = len(found.faults)
        listed = "the fault that is listed" if count == 1 else f"the {count} faults that are listed"
        raise AssetError(f"The {kind} '{found.name}' {why}: correct {listed}.")


def picture_file(folder: Path, name: str, flag: str = "--picture") -> OutFile:
    """Return the picture's file; an earlier picture drawn by this program is replaced."""
    place, instead = folder / f"{Path(name).stem}.png", f"name another path with {flag}"
    return OutFile(place, instead, force=True, is_kind=is_drawn_here)


def is_drawn_here(path: Path) -> bool:
    """Return whether a file is a PNG that was drawn here."""
    head = path.read_bytes()[:4096]
    return head.startswith(b"\x89PNG") and b"tEXtSoftware\0qdgrasp" in head


def draw_asset(asset: Gripper | ObjectModel | Mesh, name: str, folder: Path) -> Path:
    """Draw a hand, an object or a mesh into the picture's file; returns its path."""
    # matplotlib takes half a second to import, and most commands draw nothing
    from qdgrasp_tools.rendering.drawings import draw_gripper, draw_mesh, draw_object

    drawn = picture_file(folder, name)
    with drawn.writing() as made:
        if isinstance(asset, Gripper):
            draw_gripper(asset.on_carrier("paper"), made)
        elif isinstance(asset, Mesh):
            draw_mesh(name, asset, made)
        else:
            draw_object(asset, made)
    return drawn.path


asset_app = typer.Typer(name="asset", no_args_is_help=True, help="Grippers and objects: list and fetch them.")


@asset_app.command("list")
def list_assets(as_json: options.Json = False) -> None:
    """Name every gripper and object, where it is and under which licence; needs no network.

    Example: qdgrasp asset list --json
    """
    tables = {"grippers": catalog.every_gripper(), "objects": catalog.every_object()}
    if as_json:
        echo(json.dumps({kind: [asdict(entry) for entry in table] for kind, table in tables.items()}))
        return
    for kind, table in tables.items():
        echo(kind)
        for entry in table:
            echo(f"  {entry.name:<20} {entry.source:<11} {entry.licence}")


@asset_app.command()
def fetch(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAMES]...", help="Scans, ycb_NAME; default: all absent.")
    ] = None,
    home: Annotated[
        str, typer.Option("--from", envvar="QDGRASP_YCB_URL", help="Address of the YCB set or of a mirror.")
    ] = YCB_HOME,
) -> None:
    """Fetch scans of the YCB Object and Model Set (CC BY 4.0) and check them;
    repeat it to continue.

    Example: qdgrasp asset fetch ycb_mug ycb_bowl
    """  # noqa: D205  # typer joins the lines
    wanted = names or [name for name in ycb.SCAN_NAMES if ycb.scan_source(name) == catalog.ABSENT]
    echo(YCB_TERMS, err=True)
    refused = []
    for name in wanted:
        try:
            with progress_messages() as tell:
                fetched = fetch_scan(name, home, tell)
            echo(f"{name}: fetched, and it measures what it must: {fetched}")
        except WrongScan as error:
            refused.append(str(error))
    if refused:
        raise AssetError(" ".join(refused))
    if not wanted:
        echo("Every scan is there already; name one to fetch it again.")


@asset_app.command("resting-poses")
def resting_poses_of(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE", help="An object of the catalog, or a mesh.")],
    units: options.Units = None,
    as_json: options.Json = False,
) -> None:
    """List how an object comes to rest on a table, the likeliest way first.

    Of each: its number, which --resting-pose takes; its probability, where the object is dropped in any way;
    which direction of the object's frame is up then; and how far above the table the centre of mass is.

    Example: qdgrasp asset resting-poses mug
    """
    from qdgrasp_assets.geometry.resting_poses import resting_poses  # scipy takes its time

    values = {"gripper": "", "object": name, "scale": options.scale_of_units(units)}
    mass = {} if is_in_catalog(name) else {"mass": 1.0}
    poses = resting_poses(catalog.object_shape(run_spec(values | mass, "asset resting-poses")).collision)
    if as_json:
        echo(json.dumps(msgspec.to_builtins(poses)))
        return
    echo(f"{'pose':>4} {'probability':>11}  {'up':<22} {'height [m]':>10}")
    for number, pose in enumerate(poses):
        up = " ".join(f"{value:6.3f}" for value in pose.up)
        echo(f"{number:>4} {pose.probability:>11.3f}  {up:<22} {-pose.height:>10.4f}")


object_app = typer.Typer(
    name="object", no_args_is_help=True, help="Custom objects: check them, and repair their meshes."
)


@object_app.callback()
def _group() -> None:
    """Keep `check` a subcommand: typer would drop the name of a single command."""


@object_app.command("check")
def check_object(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A mesh: STL, OBJ, PLY, OFF or GLB.")],
    units: options.Units = None,
    mass: Annotated[
        float | None, typer.Option(metavar="KG", help="Mass of the object; runs need it.")
    ] = None,
    mesh: options.Mesh = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw it and its convex parts, or where it is open.")
    ] = None,
    repaired: Annotated[
        Path | None,
        typer.Option(metavar="OUT", help="Write the mesh as it is used, in metres, to a new file."),
    ] = None,
    no_parts: Annotated[bool, typer.Option("--no-parts", help="Do not look for convex parts.")] = False,
    as_json: options.Json = False,
) -> None:
    """Say what an object of your own is, what was repaired, and what is wrong with it.

    Seams, empty triangles and windings are repaired, in every run as here. --mesh changes meshes that cannot
    be used as they are, and is a flag of a run too. Exit code 2: it cannot be used.

    Example: qdgrasp object check part.stl --units mm --mass 0.3 --picture pictures
    """
    if mass is not None:
        run_spec({"gripper": "", "object": "", "mass": mass}, "object check")
    metres, path, writing = options.scale_of_units(units), named_path(file), None
    if picture is not None:
        picture_file(picture, path.name).check()
    if repaired is not None:
        writing = OutFile(repaired, "name another path with --repaired", suffixes=WRITABLE_FORMATS)
        writing.check()
    prepared = options.preparation(mesh)
    glued = prepared is not None and prepared.glued
    draft = read_draft(path, metres, prepared)
    found = inspect_object(draft, file, scale=metres, mass=mass, glued=glued, parts=not no_parts)
    print_findings(found, as_json=as_json)
    if picture is not None:
        shown: Mesh | ObjectModel = draft.mesh
        if found.values.get("convex"):
            facts = file_facts(RunSpec(gripper="", object=str(path), mass=1.0))
            shown = ObjectModel(**vars(facts), **vars(geometry_of(draft)))
        echo(f"drawn: {draw_asset(shown, path.name, picture)}", err=as_json)
    if writing is not None and not found.faults:
        writing.write(to_bytes(draft.mesh, writing.path.suffix))
        triangles = counted(len(draft.mesh.faces), "triangle")
        echo(f"written: {writing.path}, in metres, with {triangles}", err=as_json)
    refuse_faulty("object", found)
    if repaired is not None:
        file, metres, mesh = str(repaired), None, "glued" if glued else None
    size = "" if metres is None else f" {scale_in_words(metres)}"
    weight = (
        f" --mass {'KG' if mass is None else f'{mass:g}'}{f' --mesh {shlex.quote(mesh)}' if mesh else ''}"
    )
    echo(f"next: qdgrasp run --gripper panda --object {shlex.quote(file)}{size}{weight}", err=as_json)
