"""What the commands share that carry a job out on this machine."""

import typer

from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.supervisor import Supervisor, Team
from qdgrasp_protocol.errors import EndedEarly
from qdgrasp_protocol.lifetime import Stop


def carry_out(job: JobFolder, team: Team, shown: Display, stop: Stop) -> None:
    """Carry a job out; what ends it early names the command that goes on."""
    try:
        Supervisor(job, team, shown, stop).run()
    except EndedEarly as error:
        raise EndedEarly(f"{error} {going_on(job)}") from None


def check_not_stopped(job: JobFolder, stop: Stop) -> None:
    """End as a signal has asked, and name the command that goes on."""
    if stop.is_set:
        typer.echo(f"Stopped; {going_on(job)}", err=True)
        raise typer.Exit(stop.exit_code)


def going_on(job: JobFolder) -> str:
    """What a person is told of a job that is not done."""
    command = "campaign" if job.is_campaign else "resume"
    return f"`qdgrasp {command} {job.path}` goes on where it stopped."
