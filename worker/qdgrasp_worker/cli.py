"""`qdgrasp-worker`: evaluates for the jobs on a bus."""

import json
import os
import sys
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Annotated, Any

import structlog
import typer
from setproctitle import setproctitle

from qdgrasp_assets.code_version import building_code
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import echo, run_command
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import (
    GRACE,
    GRACE_MARGIN,
    ONE_THREAD,
    DiesAgain,
    ProcessExit,
    ProcessSupervisor,
    Stop,
    check_workers,
    configure_logging,
    lifetime,
)
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.spec import DEVICE_ENGINE, DEVICE_VARIABLE, MOST_WORLDS, Device

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
log = structlog.get_logger()

MEGABYTE = 1_000_000
MEMORY, DEVICE_MEMORY = 2000, 32000
"""Megabytes; a device's kernels are compiled in the simulator, and its memory is mapped there too."""
ROW_SECONDS, DEVICE_SECONDS = 30.0, 900.0


@app.command()
def worker(
    connect: cli_support.ConnectOption = None,
    security: cli_support.SecurityOption = None,
    job: Annotated[str | None, typer.Option(help="Serve this job only; default: every job there is.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="How many workers, on one core each.")] = 1,
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
    ] = 0,
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

    It needs nothing but this package: scenes come over the bus. SIGTERM lets the batch in work be finished
    within the grace, SIGINT (Ctrl-C) ends at once; nothing is lost either way.

    Example: qdgrasp-worker --connect tls/head:7447 --security security --workers 4
    """
    with lifetime("qdgrasp-worker") as stop:
        os.environ.update(ONE_THREAD | os.environ)
        if worlds is not None and device is None:
            raise InputError("--worlds goes with a device: name it with --device.")
        check_workers(workers)
        found = Device.find(device, worlds) if device else None
        if self_test:
            from qdgrasp_worker.platform import platform

            echo(json.dumps(platform(found)))
            return
        configure_logging("worker")
        if workers > 1:
            folder = ["--security", str(security)] if security else []
            pool = WorkerPool(workers, [*sys.argv[1:], "--workers", "1", *folder], grace=grace)
            pool.run(stop)
            raise typer.Exit(stop.exit_code or pool.exit_code)
        from qdgrasp_worker.runtime.simulator_supervisor import (
            MEMORY_HEADROOM,
            SimulatorClient,
            SimulatorSupervisor,
            simulator_command,
        )

        credentials = Credentials.find(security, Role.WORKER)
        inbox: SimpleQueue[Any] = SimpleQueue()
        memory = MEGABYTE * (memory or (DEVICE_MEMORY if found else MEMORY))
        row_seconds = row_seconds or (DEVICE_SECONDS if found else ROW_SECONDS)
        limits = map(str, (row_seconds, round(MEMORY_HEADROOM * memory), nice))
        command = [*simulator_command(evaluator, found), *limits]
        with SimulatorSupervisor(
            lambda: SimulatorClient(command, inbox.put), row_seconds=row_seconds, memory=memory
        ) as simulator:
            from qdgrasp_protocol.zenoh_bus import ZenohBus  # the first simulator starts meanwhile
            from qdgrasp_worker.runtime.service import WorkerService

            with ZenohBus.connect(connect, wait, stop, credentials) as bus:
                rows = found.worlds if found else 0
                WorkerService(
                    bus,
                    stop,
                    simulator,
                    inbox,
                    job=job,
                    grace=grace,
                    rows=rows,
                    builds="" if found else building_code(),
                    nice=nice,
                ).run()
        log.info("stopped")
    raise typer.Exit(stop.exit_code)


LOOK_INTERVAL = 0.2  # seconds between two looks at the workers
STEADY_SECONDS = 60.0  # seconds of life after which a worker's deaths count anew


class WorkerPool:
    """Several workers with the same arguments, restarted when they die.

    Each may take `grace` seconds to stop. A worker is given up that left by itself, that bad input ended at
    its first start, as it would at any other, or that dies again and again.
    """

    def __init__(self, size: int, arguments: list[str], *, grace: float) -> None:
        self._size = size
        self._arguments = arguments
        self._grace = max(GRACE, grace + GRACE_MARGIN)
        self._served: set[str] = set()  # Workers that were started a second time
        self._running: set[str] = set()
        self.exit_code = 0
        """Exit code of the worker that was given up last."""

    def run(self, stop: Stop) -> None:
        """Start the workers and watch them until a signal comes, or all are given up."""
        setproctitle("qdgrasp-workers")
        woken: SimpleQueue[None] = SimpleQueue()
        stop.tell(lambda: woken.put(None))
        with ProcessSupervisor(None, self._grace, STEADY_SECONDS) as processes:
            for name in [f"worker-{number}" for number in range(self._size)]:
                processes.start(name, "qdgrasp_worker.cli", lambda: self._arguments)
                self._running.add(name)
            while self._running and not stop.is_set:
                for death in processes.exits():
                    self.on_death(processes, death, monotonic())
                processes.restart_due(monotonic())
                with suppress(Empty):
                    woken.get(timeout=LOOK_INTERVAL)
            passed_on = None  # Signal that the workers were sent last: SIGINT may follow on SIGTERM
            while stop.is_set and processes.pids() and not processes.is_late(monotonic()):
                if stop.latest is not None and stop.latest != passed_on:
                    passed_on = stop.latest
                    processes.request_stop(passed_on)
                with suppress(Empty):
                    woken.get(timeout=LOOK_INTERVAL)

    def on_death(self, processes: ProcessSupervisor, death: ProcessExit, now: float) -> None:
        """Plan the next start of a worker that died, or give it up."""
        is_hopeless = death.exit_code == InputError.exit_code and death.name not in self._served
        if death.exit_code == 0 or is_hopeless:
            self._give_up(death)
            return
        self._served.add(death.name)
        try:
            pause = processes.restart_later(death, now)
        except DiesAgain as error:
            log.error(f"{error} It is not started again.")
            self._give_up(death)
        else:
            log.warning(f"{death.name} {death.description}; it is started again in {pause:.1f} s")

    def _give_up(self, death: ProcessExit) -> None:
        self._running.discard(death.name)
        self.exit_code = death.exit_code if death.exit_code >= 0 else 1


def main() -> None:
    """Entry point of `qdgrasp-worker`."""
    run_command(app, "qdgrasp-worker")


if __name__ == "__main__":
    main()
