"""`qdgrasp merge`: the successes of several runs in one folder."""

import json
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.phrases import counted


def merge(
    directories: Annotated[
        list[Path], typer.Argument(metavar="DIRS...", help="Folders of runs, pruned or merged ones too.")
    ],
    out: Annotated[Path, typer.Option(help="The new folder.")],
    as_json: options.Json = False,
) -> None:
    """Join the successes of runs of one scene, whatever their methods and seeds.

    The new folder is read like a run's: info, coverage, reference, rerank. It keeps what each run was, and
    which rows are its own. A run that is named twice counts once, and so does one beside an earlier copy of
    itself. The runs stay as they are.

    Example: qdgrasp merge runs/mug-s0 runs/mug-s1 --out runs/mug-all
    """
    from qdgrasp_coordinator.keeping.merging import (
        merge as merge_runs,  # the scene's libraries take their time
    )

    merged = merge_runs([RunFolder.open(directory) for directory in directories], out)
    found = merged.summary
    if as_json:
        typer.echo(json.dumps(msgspec.to_builtins(found) | {"repeats": list(merged.repeats)}))
        return
    for sentence in merged.repeats:
        typer.echo(sentence)
    typer.echo(f"{found.words} {counted(len(found.sources), 'run')} in {out}.")
