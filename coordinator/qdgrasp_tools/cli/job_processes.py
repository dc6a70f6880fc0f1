"""`qdgrasp-coordinator`, `qdgrasp-recorder` and `qdgrasp-router`: the processes of a job.

Each loads what it alone needs when it starts, as a run waits for all of them.
"""

import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated

import structlog
import typer

from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.process import configure_logging, lifetime
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.session import Credentials, Role, default_endpoint
from qdgrasp_protocol.spec import read_run_spec
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.cli import options

if TYPE_CHECKING:
    from qdgrasp_coordinator.scheduler.run_plan import RunQueue

APPS = {
    name: typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    for name in ("coordinator", "recorder", "router")
}
"""The programs by name."""
log = structlog.get_logger()


@APPS["coordinator"].command()
def coordinator(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.toml|DIR", help="A run's spec, a campaign's file, or the folder of one."
        ),
    ],
    listen: options.Listen = None,
    connect: Annotated[
        str | None,
        typer.Option(help="Endpoints of routers that run already, separated by commas; default: embed one."),
    ] = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
    job: Annotated[str | None, typer.Option(help="Name on the bus; default: the folder's or file's.")] = None,
    batch_size: Annotated[
        int | None, typer.Option(min=1, max=4096, help="Rows in a batch; default: measured.")
    ] = None,
    seconds: options.Seconds = None,
    wait: cli_support.WaitOption = 30.0,
    paused: Annotated[
        bool, typer.Option("--paused", help="Hand out no work until `qdgrasp continue`.")
    ] = False,
    version: cli_support.VersionOption = False,
) -> None:
    """Run the searches of a job: ask, dispatch to workers, settle, tell;
    a recorder keeps what is found.

    Exit codes: 0 done, cancelled, or --seconds are over; 2 bad input, or nothing to connect to; 3 another
    coordinator continues the job; 143 SIGTERM. Start it again after any other one.

    Example: qdgrasp-coordinator spec.toml --listen tcp/127.0.0.1:7447
    """  # noqa: D205  # typer joins the lines
    from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
    from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient

    if connect and (listen or insecure):
        raise InputError("--listen and --insecure are for an embedded router: leave them out, or --connect.")
    folder = JobFolder.open(what) if what.is_dir() else None
    programme = runs_of_job(what, folder)
    name = job or (folder.name if folder else job_name(what.stem))
    with lifetime("qdgrasp-coordinator") as stop, ExitStack() as stack:
        configure_logging("coordinator")
        credentials = Credentials.find(security, Role.COORDINATOR if connect else Role.ROUTER)
        if connect:
            bus, endpoint = ZenohBus.connect(connect, wait, stop, credentials), connect
        else:
            bus, endpoint = ZenohBus.embedded(listen, credentials, insecure=insecure)
        stack.enter_context(bus)
        log.info("connected" if connect else "listening", endpoint=endpoint, job=name)
        if stop.is_set:  # the parent may be gone, and another coordinator have the folder
            raise typer.Exit(stop.exit_code)
        if folder is not None:
            folder.write_endpoint(endpoint)
        CoordinatorService(
            bus,
            stop,
            job=name,
            queue=programme,
            make_sink=lambda run: RecorderClient(bus, name, run.shape),
            begin_epoch=RecorderClient(bus, name, RowShape(0, 0)).begin_epoch,
            batch_size=batch_size,
            seconds=seconds,
            paused=paused,
        ).run()
    raise typer.Exit(stop.exit_code)


def runs_of_job(what: Path, folder: JobFolder | None) -> "RunQueue":
    """The runs of a job: a campaign's, or a single one."""
    from qdgrasp_coordinator.scheduler import run_plan
    from qdgrasp_tools.campaign.campaign_file import is_campaign, read_campaign
    from qdgrasp_tools.campaign.campaign_folder import CampaignRunQueue

    source = what / CAMPAIGN if folder and folder.is_campaign else what
    if source.is_file() and ((folder and folder.is_campaign) or is_campaign(source)):
        campaign = read_campaign(source)
        if campaign.stand_ins:
            log.warning("scans not found: stand-ins, without S_G coverage", objects=campaign.stand_ins)
        return CampaignRunQueue(folder, campaign.runs)
    if folder is None:
        spec = run_plan.asked_spec(read_run_spec(what), str(what))
        prepared = run_plan.prepare_scene(spec)
    else:
        run = RunFolder.open(what)
        spec, prepared = run.spec, run.prepared_scene()
    return run_plan.NamedRunQueue(lambda _: run_plan.plan_run(spec, prepared), {RUN: spec.evaluations})


@APPS["recorder"].command()
def recorder(
    job: Annotated[str, typer.Option(help="Name of the job on the bus.")],
    out: Annotated[
        Path, typer.Option(help="The job's folder, a run's or a campaign's; begun where there is none.")
    ],
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
    disk_wait: Annotated[float, typer.Option(min=0, help="Seconds to wait for room on a full disk.")] = 60.0,
    wait: cli_support.WaitOption = 30.0,
    version: cli_support.VersionOption = False,
) -> None:
    """Write what a job finds to its folder, and report what is safe on the disk.

    A single run's records lie in the folder itself, those of a campaign's runs in DIR/runs/RUN. The folder
    must not be on a network file system. One recorder at a time writes in it.

    Example: qdgrasp-recorder --connect tls/head:7447 --security security --job mugs --out runs/mugs
    """
    from qdgrasp_coordinator.recorder.recorder_service import RecorderService
    from qdgrasp_tools.monitor.queries import QueryServer

    with lifetime(f"qdgrasp-recorder {job}") as stop:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # files at a size limit count as a full disk
        configure_logging("recorder")
        credentials = Credentials.find(security, Role.RECORDER)
        with ZenohBus.connect(connect, wait, stop, credentials) as bus, QueryServer(bus, job, out):
            RecorderService(bus, stop, job=job, path=out, disk_wait=disk_wait).run()
    raise typer.Exit(stop.exit_code)


@APPS["router"].command()
def router(
    listen: Annotated[
        str | None, typer.Option(help="Endpoints, separated by commas; default: port 7447 on loopback.")
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(help="Endpoints of other routers to relay with; they may be started before or after."),
    ] = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
    version: cli_support.VersionOption = False,
) -> None:
    """Relay between coordinators, recorders, workers and monitors until SIGINT or SIGTERM.

    Clients that name two routers (--connect tls/a:7447,tls/b:7447) go over to the other when one dies.

    Example: qdgrasp-router --listen tls/0.0.0.0:7447 --security security
    """
    with lifetime("qdgrasp-router") as stop:
        configure_logging("router")
        credentials = Credentials.find(security, Role.ROUTER)
        endpoint = listen or default_endpoint(encrypted=credentials is not None).text
        with ZenohBus.router(endpoint, connect=connect, credentials=credentials, insecure=insecure):
            log.info("listening", endpoint=endpoint, relays_with=connect or "no other router")
            stopped: SimpleQueue[None] = SimpleQueue()
            stop.tell(lambda: stopped.put(None))
            if not stop.is_set:
                stopped.get()
        log.info("stopped")
    raise typer.Exit(stop.exit_code)


def main(name: str) -> None:
    """Entry point of a program."""
    run_command(APPS[name], f"qdgrasp-{name}")


if __name__ == "__main__":
    main(sys.argv.pop(1))
