"""`qdgrasp-recorder`: the process that writes the journals of a job's runs."""

import signal
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.recorder.recorder_service import RecorderService
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.process import configure_logging, lifetime
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.monitor.queries import QueryServer

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
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
    with lifetime(f"qdgrasp-recorder {job}") as stop:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # files at a size limit count as a full disk
        configure_logging("recorder")
        credentials = Credentials.find(security, Role.RECORDER)
        with ZenohBus.connect(connect, wait, stop, credentials) as bus, QueryServer(bus, job, out):
            RecorderService(bus, stop, job=job, path=out, disk_wait=disk_wait).run()
    raise typer.Exit(stop.exit_code)


def main() -> None:
    """Entry point of `qdgrasp-recorder`."""
    run_command(app, "qdgrasp-recorder")


if __name__ == "__main__":
    main()
