"""The command `coverage`: how much of a reference set a run has found."""

import json
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_coordinator.metrics.reference_coverage import coverage as coverage_of
from qdgrasp_coordinator.metrics.reference_coverage import is_stand_in, read_reference, released_archive
from qdgrasp_coordinator.metrics.scores import survival
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.cli import options


def coverage(
    directory: options.RunDir,
    reference: Annotated[Path | None, typer.Option(help="The reference set, an npz file.")] = None,
    object_: Annotated[str | None, typer.Option("--object", help="The object's name in the set.")] = None,
    as_json: options.Json = False,
) -> None:
    """Say how much of a reference set of graspable positions a run has found.

    Counted are distinct success positions, rounded to 1 cm, that are in the set, over its size.

    Example: qdgrasp coverage runs/demo --reference S_G_panda_2f.npz --object rubiks_cube
    """
    if reference is None or object_ is None:
        raise InputError(f"{'--reference' if reference is None else '--object'} is missing; see --help.")
    folder = RunFolder.open(directory)
    entries = read_reference(reference, object_)
    scene = folder.scene()
    stand_in = is_stand_in(folder.spec.object, entries)
    with folder.journal() as journal:
        successes = journal.successes()
    positions = successes["base_to_object"][:, :3]
    found = coverage_of(positions, survival(successes), entries, released_archive(scene))
    if as_json:
        values = {"object": object_, "stand_in": stand_in}
        echo(json.dumps(msgspec.to_builtins(found) | values))
        return
    stands_in = " The run is on a stand-in for the scan." if stand_in else ""
    echo(found.sentence + stands_in)
