"""`qdgrasp-worker`: evaluates for the jobs on a bus."""

import json
import os
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Any

import structlog
import typer

from qdgrasp_assets.asset_paths import cache_folder
from qdgrasp_assets.code_version import building_code
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import echo, run_command
from qdgrasp_protocol.engines import DEVICE_ENGINE, DEVICE_VARIABLE, MOST_WORLDS, Device
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import ONE_THREAD, configure_logging, lifetime
from qdgrasp_protocol.session import Credentials, Role

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
log = structlog.get_logger()

MEGABYTE = 1_000_000
MEMORY, DEVICE_MEMORY = 2000, 32000
"""Megabytes; a device's kernels are compiled in the simulator, and its memory is mapped there too."""
ROW_SECONDS, DEVICE_SECONDS = 30.0, 900.0


@app.command()
def worker(
    context: typer.Context,
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
    job: Annotated[str | None, typer.Option(help="Serve this job only; default: every job there is.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="How many workers, on one core each.")] = 1,
    cache: Annotated[Path | None, typer.Option(help="Where scenes are kept between runs.")] = None,
    wait: cli_support.WaitOption = 30.0,
    grace: Annotated[
        float, typer.Option(min=0, help="Seconds that the batch in work may still take after SIGTERM.")
    ] = 1.5,
    memory: Annotated[
        int | None,
        typer.Option(
            min=300,
            help="Megabytes that a simulator may keep; above, another one is started. "
            f"Default {MEMORY}, with a device {DEVICE_MEMORY}.",
        ),
    ] = None,
    row_seconds: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="CPU seconds that an evaluation, or a device's rows together, may take. "
            f"Default {ROW_SECONDS:g}, with a device {DEVICE_SECONDS:g}.",
        ),
    ] = None,
    nice: Annotated[
        int,
        typer.Option(
            min=0,
            max=19,
            envvar="QDGRASP_NICE",
            help="How far simulators stand back behind other processes; 0: not at all.",
        ),
    ] = 10,
    pin: Annotated[bool, typer.Option("--pin", help="Keep each of several workers on one core.")] = False,
    evaluator: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.py:NAME", help="Judge poses with Python code of your own, in the simulator's place."
        ),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(
            metavar="cuda|cpu",
            envvar=DEVICE_VARIABLE,
            help=f"Evaluate scenes of the engine {DEVICE_ENGINE} too, on this device; cpu is for tests.",
        ),
    ] = None,
    worlds: Annotated[
        int | None,
        typer.Option(
            min=1, max=MOST_WORLDS, help="Rows that the device evaluates at once; default: as fill it."
        ),
    ] = None,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Evaluate the probe set, print the platform as JSON, and end.")
    ] = False,
    version: cli_support.VersionOption = False,
) -> None:
    """Evaluate grasps for the jobs on a bus, with one simulator on one core for each worker.

    It needs nothing but this package: scenes come over the bus. SIGTERM lets the batch in work be finished if
    that fits into the grace, SIGINT (Ctrl-C) ends at once; nothing is lost either way.

    Example: qdgrasp-worker --connect tls/head:7447 --security security --workers 4
    """
    with lifetime("qdgrasp-worker") as stop:
        os.environ.update(ONE_THREAD | os.environ)
        if worlds is not None and device is None:
            raise InputError("--worlds goes with a device: name it with --device.")
        found = Device.find(device, worlds) if device else None
        if self_test:
            from qdgrasp_worker.platform import platform

            echo(json.dumps(platform(found)))
            return
        configure_logging("worker")
        if workers > 1:
            from qdgrasp_worker.runtime.worker_pool import WorkerPool, worker_arguments

            pool = WorkerPool(workers, worker_arguments(context), grace=grace, is_pinned=pin)
            pool.run(stop)
            raise typer.Exit(stop.exit_code or pool.exit_code)
        from qdgrasp_worker.runtime.simulator_supervisor import SimulatorSupervisor, simulator_command

        credentials = Credentials.find(security, Role.WORKER)
        inbox: SimpleQueue[Any] = SimpleQueue()
        command = simulator_command(evaluator, found)
        memory = memory or (DEVICE_MEMORY if found else MEMORY)
        row_seconds = row_seconds or (DEVICE_SECONDS if found else ROW_SECONDS)
        with SimulatorSupervisor.open(inbox.put, row_seconds, memory * MEGABYTE, nice, command) as simulator:
            from qdgrasp_protocol.zenoh_bus import ZenohBus  # the first simulator starts meanwhile
            from qdgrasp_worker.runtime.background_requests import SceneStore
            from qdgrasp_worker.runtime.service import WorkerService

            store = SceneStore(cache or cache_folder() / "scenes")
            with ZenohBus.connect(connect, wait, stop, credentials) as bus:
                rows = found.worlds if found else 0
                WorkerService(
                    bus,
                    stop,
                    simulator,
                    inbox,
                    store=store,
                    job=job,
                    grace=grace,
                    rows=rows,
                    builds="" if found else building_code(),
                    nice=nice,
                ).run()
        log.info("stopped")
    raise typer.Exit(stop.exit_code)


def main() -> None:
    """Entry point of `qdgrasp-worker`."""
    run_command(app, "qdgrasp-worker")


if __name__ == "__main__":
    main()
