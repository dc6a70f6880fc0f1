"""`qdgrasp-coordinator`: the process that runs the search of a job."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import structlog
import typer

from qdgrasp_coordinator.scheduler import run_plan
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.scheduler.run_plan import RunQueue, SingleRunQueue
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.process import configure_logging, lifetime
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.spec import read_run_spec
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.campaign.campaign_file import is_campaign, read_campaign
from qdgrasp_tools.campaign.campaign_folder import CampaignRunQueue
from qdgrasp_tools.cli import options

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
log = structlog.get_logger()


@app.command()
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


def runs_of_job(what: Path, folder: JobFolder | None) -> RunQueue:
    """The runs of a job: a campaign's, or a single one."""
    source = what / CAMPAIGN if folder and folder.is_campaign else what
    if source.is_file() and ((folder and folder.is_campaign) or is_campaign(source)):
        campaign = read_campaign(source)
        if campaign.stand_ins:
            log.warning("scans not found: stand-ins, without S_G coverage", objects=campaign.stand_ins)
        return CampaignRunQueue(folder, campaign.runs)
    if folder is None:
        spec = run_plan.full_spec(run_plan.RUN_DEFAULTS | read_run_spec(what), str(what))
        prepared = run_plan.prepare_scene(spec)
    else:
        run = RunFolder.open(what)
        spec, prepared = run.spec, run.prepared_scene()
    return SingleRunQueue(lambda: run_plan.plan_run(spec, prepared), spec.evaluations)


def main() -> None:
    """Entry point of `qdgrasp-coordinator`."""
    run_command(app, "qdgrasp-coordinator")


if __name__ == "__main__":
    main()
