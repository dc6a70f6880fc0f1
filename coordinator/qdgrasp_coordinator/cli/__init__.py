"""The command line: `qdgrasp` and the processes it starts."""

import typer

from qdgrasp_coordinator.cli import coverage, digest, doctor, evaluate, info, resume, run
from qdgrasp_protocol.command import run_command

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Archives of diverse, robust 6-DoF grasps by quality-diversity search.",
)
for command in (run.run, resume.resume, info.info, digest.digest, evaluate.evaluate, coverage.coverage):
    app.command()(command)
app.command()(doctor.doctor)


def main() -> None:
    """Entry point of `qdgrasp`."""
    run_command(app, "qdgrasp")


if __name__ == "__main__":
    main()
