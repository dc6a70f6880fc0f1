"""`qdgrasp jobs`: what runs where, since when, and how far."""

import json

import msgspec
import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.asking import nobody, place, session
from qdgrasp_coordinator.monitor.overview import lines, overview, utc_now
from qdgrasp_protocol import flags
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.printable import printable


def jobs(
    connect: flags.Connect = None, security: flags.Security = None, as_json: options.Json = False
) -> None:
    """Say which jobs there are, what they have done, and who works on them.

    Example: qdgrasp jobs --connect tcp/head:7447
    """
    endpoint = place(connect, security)
    with session(endpoint, security, Role.MONITOR) as bus:
        found = overview(bus)
    if as_json:
        typer.echo(json.dumps({"endpoint": endpoint, "jobs": msgspec.to_builtins(found)}))
    elif not found:
        typer.echo(nobody(endpoint))
    for job in () if as_json else found:
        for line in lines(job, utc_now()):
            typer.echo(printable(line))
