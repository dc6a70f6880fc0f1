"""`qdgrasp object`: examine a mesh file as an object, and repair it."""

import shlex
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_assets.asset_paths import named_path, path_problem
from qdgrasp_assets.asset_report import ObjectReport, inspect_object
from qdgrasp_assets.catalog import object_names
from qdgrasp_assets.geometry.collision_parts import ignore_progress
from qdgrasp_assets.geometry.mesh_io import WRITABLE_FORMATS, scale_in_words, to_bytes
from qdgrasp_assets.object_model import ObjectDraft, ObjectModel, file_facts, geometry_of, read_draft
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import run_spec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.cli import asset_commands, options
from qdgrasp_tools.local.progress import progress_messages

object_app = typer.Typer(
    name="object", no_args_is_help=True, help="Custom objects: check them, and repair their meshes."
)


@object_app.callback()
def _group() -> None:
    """Keep `check` a subcommand: typer would drop the name of a single command."""


@object_app.command()
def check(
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
    fill_holes: Annotated[
        bool, typer.Option("--fill-holes", help="Fill holes up to a fifth of the object's size.")
    ] = False,
    no_parts: Annotated[
        bool, typer.Option("--no-parts", help="Do not look for convex parts, which may take minutes.")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Say what an object of your own is, what was repaired, and what is wrong with it.

    Seams, empty triangles and windings are repaired, in every run as here. --mesh changes meshes that cannot
    be used as they are, and is a flag of a run too. Holes are filled only
    where asked for; the file that --repaired writes is then your object. Exit code 2: it cannot be used.

    Example: qdgrasp object check part.stl --units mm --mass 0.3 --picture pictures
    """
    if mass is not None:
        run_spec({"gripper": "", "object": "", "mass": mass}, "object check")
    metres, path, writing = options.scale_of_units(units), _found(file), None
    drawing = asset_commands.picture_folder(picture, "--picture", [path.name])
    if repaired is not None:
        writing = OutFile(repaired, "name another path with --repaired", suffixes=WRITABLE_FORMATS)
        writing.check()
    prepared = options.preparation(mesh)
    glued = prepared is not None and prepared.glued
    draft = read_draft(path, metres, prepared, fill_holes=fill_holes)
    with nullcontext(ignore_progress) if as_json else progress_messages() as tell:
        tell("looking at its surface")
        found = inspect_object(
            draft,
            file,
            scale=metres,
            mass=mass,
            glued=glued,
            parts=not no_parts,
            tell=tell,
        )
    asset_commands.print_findings(found, as_json=as_json)
    for line in _made(found, draft, path, drawing, writing):
        echo(line, err=as_json)
    asset_commands.refuse_faulty("object", found)
    if repaired is not None:
        file, metres, prepared = str(repaired), None, MeshPreparation(glued=glued)
    changes = options.mesh_words(prepared)
    echo(f"next: {_next(file, metres, mass)}{f' --mesh {changes}' if changes else ''}", err=as_json)


def _found(file: str) -> Path:
    path = named_path(file)
    if file in object_names() and path_problem(path):
        raise AssetError(
            f"'{file}' is an object of the catalog, no file; `qdgrasp asset check {file}` checks it."
        )
    return path


def _made(
    found: ObjectReport, draft: ObjectDraft, path: Path, drawing: Path | None, writing: OutFile | None
) -> Iterator[str]:
    if drawing is not None:
        yield f"drawn: {_drawn(found, draft, path, drawing)}"
    if writing is not None and not found.faults:
        writing.write(to_bytes(draft.mesh, writing.path.suffix))
        yield f"written: {writing.path}, in metres, with {counted(len(draft.mesh.faces), 'triangle')}"


def _drawn(found: ObjectReport, draft: ObjectDraft, path: Path, folder: Path) -> Path:
    if found.convex is not None:
        facts = file_facts(path, found.mass or 1.0)
        body = ObjectModel(**vars(facts), **vars(geometry_of(draft, path.name)))
        return asset_commands.draw_asset(body, path.name, folder)
    from qdgrasp_tools.rendering.drawings import draw_mesh  # matplotlib takes its time to import

    drawn = asset_commands.picture_file(folder, path.name)
    with drawn.writing() as made:
        draw_mesh(path.name, draft.mesh, made)
    return drawn.path


def _next(file: str, scale: float | None, mass: float | None) -> str:
    size = "" if scale is None else f" {scale_in_words(scale)}"
    weight = "KG" if mass is None else f"{mass:g}"
    return f"qdgrasp run --gripper panda --object {shlex.quote(file)}{size} --mass {weight}"
