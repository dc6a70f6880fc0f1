"""`qdgrasp-monitor`: watches running jobs, on a terminal, as JSON, or on a page."""

import io
import json
import logging
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Annotated

import msgspec
import structlog
import typer
from rich.console import Console

from qdgrasp_protocol import cli_support
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.cli_support import echo, run_command
from qdgrasp_protocol.errors import EXTRAS, InputError, UnknownName, check_packages
from qdgrasp_protocol.process import Stop, configure_logging, lifetime
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.cli.job_commands import SESSION_SECONDS, JobDir, JobPlace, open_session
from qdgrasp_tools.cli.options import host_and_port
from qdgrasp_tools.monitor.feed import Feed, RecordFeed, query_jobs
from qdgrasp_tools.monitor.job_model import JobView
from qdgrasp_tools.monitor.records import BusRecords
from qdgrasp_tools.monitor.terminal import ScreenState, intervals, local_time, report, watch_jobs

log = structlog.get_logger()
INTERVAL = 1.0  # seconds between two lines of JSON

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def monitor(
    directory: JobDir = None,
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
    job: Annotated[str | None, typer.Option(metavar="NAME", help="Watch this job only.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Print one look, and end.")] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print a JSON object in a line: with --once one, else one a second."),
    ] = False,
    web: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Serve a page there, and metrics at /metrics.")
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="QDGRASP_TOKEN",
            help="Token that a browser must show; beyond loopback there always is one, if need be a new one. "
            "Other users of this machine read it in the list of processes: rather set the variable.",
        ),
    ] = None,
    wait: cli_support.WaitOption = SESSION_SECONDS,
    version: cli_support.VersionOption = False,
) -> None:
    """Watch running jobs: how far they are, what they find, who works, and why evaluations fail.

    Nothing is changed or slowed by it. On a terminal: q leaves, tab or a number takes another job; o, r, w
    and e show all objects, runs, workers and events.

    Example: qdgrasp-monitor --connect tcp/head:7447

    Example: qdgrasp-monitor runs/mugs
    """
    if web is not None:
        if once or as_json:
            raise InputError("--web serves a page: leave out --once and --json, or it.")
        check_packages("--web", *EXTRAS["monitor"])
    configure_logging("monitor", level=logging.INFO if web else logging.ERROR)
    place = JobPlace.of(directory, connect, security)
    endpoint = place.endpoint
    if place.folder is not None:
        if job is not None:
            raise InputError(f"{directory} says which job is meant: leave out --job, or it.")
        job = place.folder.name
    if once:
        with open_session(endpoint, security, Role.MONITOR, wait) as bus:
            there = query_jobs(bus)
        found = place.chosen(there.views(time.time()))
        if not found and place.folder is not None:
            raise place.folder.no_coordinator()
        views = chosen_views(found, job)
        if as_json:
            echo(to_json(views, endpoint))
        else:
            print_look(views, endpoint)
        return
    with lifetime("qdgrasp-monitor") as stop, ExitStack() as stack:
        credentials = Credentials.find(security, Role.MONITOR)
        bus = stack.enter_context(ZenohBus.connect(endpoint, wait, stop, credentials))
        feed = stack.enter_context(Feed(bus, job))
        if web is not None:
            serve_page(bus, feed, web, token or "", stop)
        elif as_json:
            stream_looks(feed, endpoint, stop)
        else:
            watch_jobs(feed, RecordFeed(BusRecords(bus)), endpoint, terminal_console(), stop)
    raise typer.Exit(stop.exit_code)


def chosen_views(views: Sequence[JobView], job: str | None) -> Sequence[JobView]:
    """Return the view of one job, or all views; raises UnknownName if only other jobs are there."""
    if job and views and job not in [view.job for view in views]:
        raise UnknownName("job", job, [view.job for view in views])
    return [view for view in views if job in (None, view.job)]


def print_look(views: Sequence[JobView], endpoint: str) -> None:
    """Print the state of jobs once."""
    terminal_console().print(report(ScreenState(views, endpoint, local_time())))


def terminal_console() -> Console:
    """Return the terminal; one that is not UTF-8 shows question marks for what it lacks."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    return Console(highlight=False)


def stream_looks(feed: Feed, endpoint: str, stop: Stop) -> None:
    """Print the state of jobs every second."""
    feed.wait(INTERVAL)
    for _ in intervals(INTERVAL, stop):
        echo(to_json(feed.views(), endpoint))


def serve_page(bus: Bus, feed: Feed, web: str, token: str, stop: Stop) -> None:
    """Serve the page; its packages are loaded for it alone."""
    from qdgrasp_tools.monitor.web.run_cache import JobCaches
    from qdgrasp_tools.monitor.web.server import live_routes
    from qdgrasp_tools.monitor.web.server import serve as serve_routes

    host, port = host_and_port(web)
    routes = live_routes(feed, JobCaches(BusRecords(bus)), stop)
    serve_routes(
        routes, host, port, token, stop, lambda address: log.info("the page is open", address=address)
    )


def to_json(views: Sequence[JobView], endpoint: str) -> str:
    """Return jobs as one line of JSON; names are those of the structs (docs/watching.md)."""
    return json.dumps({"endpoint": endpoint, "jobs": msgspec.to_builtins(views)})


def main() -> None:
    """Entry point of `qdgrasp-monitor`."""
    run_command(app, "qdgrasp-monitor")


if __name__ == "__main__":
    main()
