"""`qdgrasp`: the table of its commands."""

import logging
from collections.abc import Callable

import typer

from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.process import configure_logging
from qdgrasp_tools.cli import (
    asset_commands,
    campaign_commands,
    grasp_commands,
    gripper_commands,
    inspection_commands,
    job_commands,
    machine_commands,
    run_commands,
)

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


PANELS: dict[str, dict[Callable[..., None] | typer.Typer, str]] = {
    "Start here": {
        machine_commands.doctor: "Check that this machine has what a run needs.",
        run_commands.run: "Fill an archive of grasps of one hand and object.",
        run_commands.resume: "Go on with a run that was stopped, or extend a finished one.",
        campaign_commands.campaign: "Carry out many runs: hands, objects, methods, seeds.",
        inspection_commands.methods: "List the search methods with their priors and defaults.",
    },
    "Look at what was found": {
        inspection_commands.info: "Say what a run or a campaign is, and what it has found.",
        inspection_commands.view: "Show the grasps of runs in the browser, in 3D.",
        inspection_commands.show: "Print everything known about one grasp.",
        inspection_commands.render: "Draw one evaluation, as a picture or a film.",
    },
    "Share": {
        grasp_commands.export: "Write grasps to files of other tools, or as a data set.",
        grasp_commands.import_: "Turn files of grasps into poses to evaluate.",
    },
    "Your own hands and objects": {
        gripper_commands.gripper_app: "Make and check the file of a hand.",
        asset_commands.object_app: "Check and repair the mesh of an object.",
        asset_commands.asset_app: "List and fetch grippers and objects.",
    },
    "Many machines": {
        job_commands.jobs: "List the jobs on a bus, and who works on them.",
        job_commands.pause: "Hand out no more work of a job for now.",
        job_commands.continue_: "Let a paused job go on.",
        job_commands.drain: "Have workers finish their batches and leave a job.",
        job_commands.cancel: "End a job before it is done.",
        machine_commands.security_app: "Make certificates and access lists.",
    },
    "Science": {
        grasp_commands.evaluate: "Score given hand poses.",
        run_commands.rerank: "Score the best grasps of a run again, in many trials.",
        inspection_commands.verify: "Evaluate recorded rows again, and compare bit for bit.",
        inspection_commands.digest: "Print one sha256 over the rows of a run.",
        campaign_commands.coverage: "Say how much of a reference set a run has found.",
        campaign_commands.analyse: "Draw and tabulate what a campaign found.",
    },
}
"""The commands, and groups of commands, with a sentence each, by the headings of the help."""


for panel, commands in PANELS.items():
    for command, sentence in commands.items():
        if isinstance(command, typer.Typer):
            app.add_typer(command, short_help=sentence, rich_help_panel=panel)
        else:
            name = command.__name__.removesuffix("_")
            keys = getattr(command, "epilog", None)
            app.command(name, short_help=sentence, rich_help_panel=panel, epilog=keys)(command)


def main() -> None:
    """Entry point of `qdgrasp`."""
    configure_logging("qdgrasp", level=logging.WARNING)
    run_command(app, "qdgrasp")
