"""`qdgrasp-monitor`: watches running jobs, on a terminal, as JSON, or on a page."""

import json
from typing import Annotated

import msgspec
import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.asking import place, session
from qdgrasp_coordinator.monitor.jobs import JobView
from qdgrasp_coordinator.monitor.overview import lines, overview, utc_now
from qdgrasp_protocol import flags
from qdgrasp_protocol.command import run_command
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.printable import printable

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def monitor(
    connect: flags.Connect = None,
    security: flags.Security = None,
    job: Annotated[str | None, typer.Option(metavar="NAME", help="Watch this job only.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Print one look, and end.")] = False,
    as_json: options.Json = False,
    web: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Serve a page there, and metrics at /metrics.")
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(envvar="QDGRASP_TOKEN", help="What a browser must show; needed beyond loopback."),
    ] = None,
) -> None:
    """Watch running jobs; nothing is changed or slowed by it.

    Example: qdgrasp-monitor --connect tcp/head:7447
    """
    endpoint = place(connect, security)
    with session(endpoint, security, Role.MONITOR) as bus:
        show(only(overview(bus), job), endpoint, as_json=as_json)


def only(views: list[JobView], job: str | None) -> list[JobView]:
    """The job that was named; where none was, all."""
    return [view for view in views if job in (None, view.job)]


def show(views: list[JobView], endpoint: str, *, as_json: bool) -> None:
    """Print one look at jobs."""
    if as_json:
        typer.echo(json.dumps({"endpoint": endpoint, "jobs": msgspec.to_builtins(views)}))
    elif not views:
        typer.echo(f"No job is at {endpoint}: the router answers, but no coordinator does.")
    for view in () if as_json else views:
        for line in lines(view, utc_now()):
            typer.echo(printable(line))


def main() -> None:
    """Entry point of `qdgrasp-monitor`."""
    run_command(app, "qdgrasp-monitor")


if __name__ == "__main__":
    main()
