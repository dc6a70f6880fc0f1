"""`qdgrasp`: the table of its commands."""

import logging
from collections.abc import Callable

import typer

from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.process import configure_logging
from qdgrasp_tools.cli.asset_commands import asset_app, object_app
from qdgrasp_tools.cli.campaign_commands import analyse, campaign
from qdgrasp_tools.cli.grasp_commands import evaluate, export, import_
from qdgrasp_tools.cli.gripper_commands import gripper_app
from qdgrasp_tools.cli.inspection_commands import digest, info, methods, render, show, verify, view
from qdgrasp_tools.cli.job_commands import cancel, continue_, drain, jobs, pause
from qdgrasp_tools.cli.machine_commands import doctor, security_app
from qdgrasp_tools.cli.run_commands import rerank, resume, run

app = typer.Typer(
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Archives of diverse, robust 6-DoF grasps by quality-diversity search.",
    epilog="Programs of a job on several machines, each with --help: qdgrasp-router, qdgrasp-coordinator, "
    "qdgrasp-recorder, qdgrasp-worker, and qdgrasp-monitor, which watches.",
)


@app.callback()
def qdgrasp(version: cli_support.VersionOption = False) -> None:
    """Define the flags that stand before a command."""


PANELS: dict[str, tuple[Callable[..., None] | typer.Typer, ...]] = {
    "Start here": (doctor, run, resume, campaign, methods),
    "Look at what was found": (info, view, show, render),
    "Share": (export, import_),
    "Your own hands and objects": (gripper_app, object_app, asset_app),
    "Many machines": (jobs, pause, continue_, drain, cancel, security_app),
    "Science": (evaluate, rerank, verify, digest, analyse),
}
"""The commands, and groups of commands, by the headings of the help."""

for panel, commands in PANELS.items():
    for command in commands:
        if isinstance(command, typer.Typer):
            app.add_typer(command, rich_help_panel=panel)
        else:
            keys = getattr(command, "epilog", None)
            app.command(command.__name__.removesuffix("_"), rich_help_panel=panel, epilog=keys)(command)


def main() -> None:
    """Entry point of `qdgrasp`."""
    configure_logging("qdgrasp", level=logging.WARNING)
    run_command(app, "qdgrasp")
