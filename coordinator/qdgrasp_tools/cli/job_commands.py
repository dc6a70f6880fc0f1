"""Running jobs: `jobs`, `pause`, `continue`, `cancel`, `drain`; and `qdgrasp-monitor`."""

import io
import json
import logging
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import structlog
import typer
from rich.console import Console

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol import cli_support, messages
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.cli_support import echo, run_command
from qdgrasp_protocol.errors import EXTRAS, InputError, NoReply, Refused, UnknownName, check_packages
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Order, OrderReply
from qdgrasp_protocol.process import Stop, configure_logging, lifetime
from qdgrasp_protocol.session import Credentials, Role, default_endpoint, parse_endpoints
from qdgrasp_protocol.text import printable
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.cli import options
from qdgrasp_tools.cli.options import host_and_port
from qdgrasp_tools.monitor.feed import Feed, reachable_jobs, summary_lines
from qdgrasp_tools.monitor.job_model import JobView
from qdgrasp_tools.monitor.records import BusRecords
from qdgrasp_tools.monitor.terminal import watch_jobs

SESSION_SECONDS = 6.0  # seconds that a router may take to answer, over a slow link too


JobDir = Annotated[
    Path | None,
    typer.Argument(metavar="DIR", help="A job's folder: its job alone, where its coordinator listens."),
]


@dataclass(frozen=True)
class JobPlace:
    """A router at which jobs are looked for, and there one job, or any."""

    endpoint: str
    folder: JobFolder | None = None
    """The job's folder; None: any job is meant."""

    @classmethod
    def of(cls, directory: Path | None, connect: str | None, security: Path | None) -> "JobPlace":
        """Return the place of a folder's job, or of the endpoint given, or the default one.

        An InputError if both are given, and a FolderError if no coordinator of the folder's job listens.
        """
        if directory is None:
            return cls(router_endpoint(connect, security))
        if connect is not None:
            raise InputError(f"{directory} says where its coordinator listens: leave out --connect, or it.")
        folder = JobFolder.open(directory)
        if folder.endpoint is None:
            raise folder.no_coordinator()
        places = (place.reached_from(here=True) for place in parse_endpoints(folder.endpoint))
        return cls(",".join(places), folder)

    def chosen(self, views: Sequence[JobView]) -> list[JobView]:
        """Return the views of the jobs that are meant: another user's may have the same name."""
        folder = self.folder
        if folder is None:
            return list(views)
        name, identity = folder.name, folder.identity
        return [view for view in views if view.job == name and view.meta.identity in ("", identity)]


def no_job_message(endpoint: str) -> str:
    """The sentence for a router without jobs."""
    return f"No job is at {endpoint}: the router answers, but no coordinator does."


def router_endpoint(connect: str | None, security: Path | None) -> str:
    """Return the endpoint that was given, or the default one."""
    return connect or default_endpoint(encrypted=security is not None).text


def jobs(
    directory: JobDir = None,
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
    as_json: options.Json = False,
) -> None:
    """Say which jobs there are, what they have done, and who works on them.

    Example: qdgrasp jobs --connect tcp/head:7447

    Example: qdgrasp jobs runs/mugs
    """
    place = JobPlace.of(directory, connect, security)
    endpoint = place.endpoint
    credentials = Credentials.find(security, Role.MONITOR)
    with ZenohBus.connect(endpoint, SESSION_SECONDS, credentials=credentials) as bus:
        found = place.chosen(reachable_jobs(bus))
    if not found and place.folder is not None:
        raise place.folder.no_coordinator()
    if as_json:
        echo(json.dumps({"endpoint": endpoint, "jobs": msgspec.to_builtins(found)}))
    elif not found:
        echo(no_job_message(endpoint))
    for job in () if as_json else found:
        for line in summary_lines(job):
            echo(printable(line))


JobName = Annotated[str, typer.Argument(metavar="JOB", help="The job's name; `qdgrasp jobs` lists them.")]


def pause(
    job: JobName, connect: cli_support.ConnectOption = None, security: cli_support.SecurityOption = None
) -> None:
    """Hand out no more work of a job until `qdgrasp continue`; batches that are out still count.

    The results of a run do not depend on it. A coordinator that is started again goes on by itself.

    Example: qdgrasp pause mugs
    """
    send_order(job, connect, security, Order(act="pause"))


def continue_(
    job: JobName, connect: cli_support.ConnectOption = None, security: cli_support.SecurityOption = None
) -> None:
    """Let a paused job go on.

    Example: qdgrasp continue mugs
    """
    send_order(job, connect, security, Order(act="continue"))


def cancel(
    job: JobName, connect: cli_support.ConnectOption = None, security: cli_support.SecurityOption = None
) -> None:
    """End a job before it is done: what is recorded stays, and can be gone on with.

    Its coordinator ends with exit code 0. A `qdgrasp run` or `campaign` that started it ends with 1, because
    the job is not done, and names the command that goes on.

    Example: qdgrasp cancel mugs
    """
    send_order(job, connect, security, Order(act="cancel"))


def drain(
    job: JobName,
    worker: Annotated[
        str | None, typer.Option(metavar="WID", help="A worker's id, or how it begins; see `jobs --json`.")
    ] = None,
    host: Annotated[str | None, typer.Option(help="Every worker on this host.")] = None,
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
) -> None:
    """Have workers finish the batches at hand and leave a job.

    Example: qdgrasp drain mugs --host node7
    """
    if (worker is None) == (host is None):
        raise InputError("Whom is the job to do without? Name a worker with --worker, or a host with --host.")
    if worker is not None and not (worker and set(worker) <= set("0123456789abcdef") and len(worker) <= 32):
        raise InputError(f"'{worker}' is no worker's id: 32 hexadecimal digits, or the first few of them.")
    send_order(job, connect, security, Order(act="drain", worker=worker or "", host=host or ""))


def send_order(job: str, connect: str | None, security: Path | None, order: Order) -> None:
    """Send an order to a job's coordinator, and print its reply.

    Raises `UnknownName` where there is no such job, another `InputError` where it cannot be done.
    """
    endpoint = router_endpoint(connect, security)
    credentials = Credentials.find(security, Role.ADMIN)
    with ZenohBus.connect(endpoint, SESSION_SECONDS, credentials=credentials) as bus:
        try:
            answer = bus.ask(Keys(job).control, messages.encode(order))
        except Refused as refusal:
            raise InputError(f"Nothing was done: {refusal}.") from None
        except NoReply:
            raise _no_coordinator(bus, job, endpoint) from None
    echo(printable(messages.decode(answer, OrderReply).words))


def _no_coordinator(bus: Bus, job: str, endpoint: str) -> InputError:
    known = [view.meta.job for view in reachable_jobs(bus)]
    if not known:
        return InputError(no_job_message(endpoint))
    if job in known:
        return InputError(
            f"The coordinator of job '{job}' did not answer in time, and may still carry the order out: "
            "`qdgrasp jobs` shows the state of the job."
        )
    return UnknownName("job", job, known)


log = structlog.get_logger()

monitor_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@monitor_app.command()
def monitor(
    directory: JobDir = None,
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
    job: Annotated[str | None, typer.Option(metavar="NAME", help="Watch this job only.")] = None,
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

    Nothing is changed or slowed by it; `qdgrasp jobs` prints the state once. A terminal shows the first job
    that is not over in full, and any other one with --job.

    Example: qdgrasp-monitor --connect tcp/head:7447

    Example: qdgrasp-monitor runs/mugs
    """
    if web is not None:
        check_packages("--web", *EXTRAS["monitor"])
    elif not (console := terminal_console()).is_terminal or console.is_dumb_terminal:
        raise InputError("The jobs are drawn on a terminal: `qdgrasp jobs` prints them, --web serves a page.")
    configure_logging("monitor", level=logging.INFO if web else logging.ERROR)
    place = JobPlace.of(directory, connect, security)
    endpoint = place.endpoint
    if place.folder is not None:
        if job is not None:
            raise InputError(f"{directory} says which job is meant: leave out --job, or it.")
        job = place.folder.name
    with lifetime("qdgrasp-monitor") as stop, ExitStack() as stack:
        credentials = Credentials.find(security, Role.MONITOR)
        bus = stack.enter_context(ZenohBus.connect(endpoint, wait, stop, credentials))
        feed = stack.enter_context(Feed(bus, job))
        if web is not None:
            serve_page(bus, feed, web, token or "", stop)
        else:
            watch_jobs(feed, endpoint, console, stop)
    raise typer.Exit(stop.exit_code)


def terminal_console() -> Console:
    """Return the terminal; one that is not UTF-8 shows question marks for what it lacks."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    return Console(highlight=False)


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


def main() -> None:
    """Entry point of `qdgrasp-monitor`."""
    run_command(monitor_app, "qdgrasp-monitor")


if __name__ == "__main__":
    main()
