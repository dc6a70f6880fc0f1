"""`qdgrasp-worker`: one process that evaluates for the jobs on a bus."""

import json
import os
from pathlib import Path
from typing import Annotated

import structlog
import typer

from qdgrasp_assets.files import cache_folder
from qdgrasp_protocol import flags
from qdgrasp_protocol.command import run_command
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.logs import speak

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
log = structlog.get_logger()


@app.command()
def worker(
    connect: flags.Connect = None,
    security: flags.Security = None,
    job: Annotated[str | None, typer.Option(help="Serve this job only; default: every job there is.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Where scenes are kept between runs.")] = None,
    wait: Annotated[float, typer.Option(min=0, help="Seconds to wait for the router at the start.")] = 30.0,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Evaluate the probe set, print the platform as JSON, and end.")
    ] = False,
) -> None:
    """Evaluate grasps for the jobs on a bus, with one simulator on one core.

    Example: qdgrasp-worker --connect tls/head:7447 --security security
    """
    with lifetime("qdgrasp-worker") as stop:
        for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(threads, "1")
        from qdgrasp_worker.platform import platform  # after the threads are limited

        if self_test:
            typer.echo(json.dumps(platform()))
            return
        speak("worker")
        from qdgrasp_protocol.zenoh_bus import ZenohBus
        from qdgrasp_worker.bundles import Bundles
        from qdgrasp_worker.service import WorkerService

        credentials = Credentials.find(security, Role.WORKER)
        with ZenohBus.connect(connect, wait, stop, credentials) as bus:
            bundles = Bundles(cache or cache_folder() / "scenes")
            WorkerService(bus, stop, job=job, platform=platform(), bundles=bundles).run()
        log.info("stopped")
    raise typer.Exit(stop.exit_code)


def main() -> None:
    """Entry point of `qdgrasp-worker`."""
    run_command(app, "qdgrasp-worker")


if __name__ == "__main__":
    main()
