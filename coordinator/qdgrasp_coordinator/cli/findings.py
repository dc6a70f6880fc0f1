"""What a check found, as a command says it and ends with it."""

import json

import msgspec
import typer

from qdgrasp_assets.findings import Findings
from qdgrasp_protocol.errors import AssetError


def tell(found: Findings, *, as_json: bool = False) -> None:
    """Print all that was found."""
    typer.echo(json.dumps(msgspec.to_builtins(found)) if as_json else found.table)


def refuse(kind: str, found: Findings, why: str = "cannot be used as it is") -> None:
    """Refuse an asset at fault: each fault was told once, in the list.

    Raises
    ------
    AssetError
        There are faults.
    """
    if found.faults:
        count = len(found.faults)
        listed = "the fault that is listed" if count == 1 else f"the {count} faults that are listed"
        raise AssetError(f"The {kind} '{found.name}' {why}: correct {listed}.")
