"""Flags that every command on the bus shares."""

from pathlib import Path
from typing import Annotated

import typer

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
        envvar="QDGRASP_SECURITY",
        metavar="DIR",
        help="Folder of certificates, as `qdgrasp security init` writes one: links are encrypted.",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option("--insecure", help="Listen also where strangers get to, without encryption."),
]
