"""`qdgrasp reference`: reference sets of our own."""

import json
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.analysis.harvest import build as build_sets
from qdgrasp_coordinator.analysis.reference import ReferenceSet
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.phrases import counted

app = typer.Typer(no_args_is_help=True, help="Reference sets of graspable positions: build them from runs.")


@app.callback()
def _group() -> None:
    """Keep `build` a command of its own while it is the only one."""


@app.command()
def build(
    directories: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Folders of runs.")],
    out: Annotated[Path, typer.Option(help="The reference set, an npz file; added to where it exists.")],
    name: Annotated[
        str | None, typer.Option(help="The object's name in the set; default: the run's, without ycb_.")
    ] = None,
    mixed: Annotated[bool, typer.Option("--mixed", help="Take runs under different protocols.")] = False,
    as_json: options.Json = False,
) -> None:
    """Gather the cells of all successes of runs, with the best fitness in each.

    One file holds the sets of one gripper. Runs may be added later, and again.

    Example: qdgrasp reference build runs/part-s0 runs/part-s1 --out S_G_part.npz
    """
    sets = build_sets(map(RunFolder.open, directories), out, name, mixed=mixed)
    if as_json:
        typer.echo(json.dumps({"out": str(out), "objects": {key: _figures(sets[key]) for key in sets}}))
        return
    for key, known in sets.items():
        typer.echo(
            f"{out} holds {counted(len(known), 'cell')} of '{key}', {len(known.robust)} of them robust."
        )


def _figures(known: ReferenceSet) -> dict[str, int]:
    return {"size": len(known), "robust_size": len(known.robust)}
