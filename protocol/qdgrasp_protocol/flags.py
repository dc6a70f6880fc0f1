"""Flags that every command on the bus shares."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_protocol.credentials import VARIABLE

Connect = Annotated[
    str | None,
    typer.Option(
        help="Endpoint of the router, or several separated by commas: when one is lost, another takes over; "
        "default: port 7447 on loopback."
    ),
]
Wait = Annotated[float, typer.Option(min=0, help="Seconds to wait for the router at the start.")]
Security = Annotated[
    Path | None,
    typer.Option(
        envvar=VARIABLE,
        metavar="DIR",
        help="Folder of certificates, as `qdgrasp security init` writes one: links are encrypted.",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option("--insecure", help="Listen also where strangers get to, without encryption."),
]


def _say_version(context: typer.Context, wanted: bool) -> None:
    """Print which version this is, and end."""
    if wanted:
        typer.echo(f"{context.info_name} {version('qdgrasp')}")
        raise typer.Exit


Version = Annotated[
    bool,
    typer.Option("--version", is_eager=True, callback=_say_version, help="Print the version, and end."),
]
"""Taken by every command that stands alone; what it does is done before the command's function is called."""
