"""`qdgrasp digest`: one number for a whole journal."""

import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.digest import digest as digest_of
from qdgrasp_coordinator.folders.folder import RunFolder


def digest(directory: options.RunDir) -> None:
    """Print one sha256 over the journal's rows in order.

    It does not depend on workers, batches, kills, hosts or time: two runs of one spec have the same.

    Example: qdgrasp digest runs/demo
    """
    with RunFolder.open(directory).journal() as journal:
        typer.echo(digest_of(journal))
