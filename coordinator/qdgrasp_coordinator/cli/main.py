"""`qdgrasp`: the table of its commands."""

import logging

import typer

from qdgrasp_coordinator.cli import (
    asset_commands,
    campaign_commands,
    grasp_commands,
    gripper_commands,
    inspection_commands,
    job_commands,
    machine_commands,
    object_commands,
    reference_commands,
    run_commands,
)
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.process import configure_logging

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Archives of diverse, robust 6-DoF grasps by quality-diversity search.",
)


@app.callback()
def qdgrasp(version: cli_support.VersionOption = False) -> None:
    """Define the flags that stand before a command."""


for command in (
    run_commands.run,
    run_commands.resume,
    inspection_commands.info,
    inspection_commands.digest,
    grasp_commands.evaluate,
    reference_commands.coverage,
    campaign_commands.campaign,
    campaign_commands.analyse,
    inspection_commands.show,
    inspection_commands.view,
    inspection_commands.render,
    inspection_commands.verify,
    grasp_commands.export,
    grasp_commands.import_,
    run_commands.rerank,
    campaign_commands.merge,
    campaign_commands.prune,
    inspection_commands.methods,
    machine_commands.doctor,
    machine_commands.bench,
    job_commands.jobs,
    job_commands.pause,
    job_commands.continue_,
    job_commands.cancel,
    job_commands.drain,
):
    app.command(command.__name__.removesuffix("_"))(command)
app.add_typer(asset_commands.asset_app, name="asset")
app.add_typer(gripper_commands.gripper_app, name="gripper")
app.add_typer(object_commands.object_app, name="object")
app.add_typer(reference_commands.reference_app, name="reference")
app.add_typer(machine_commands.security_app, name="security")


def main() -> None:
    """Entry point of `qdgrasp`."""
    configure_logging("qdgrasp", level=logging.WARNING)
    run_command(app, "qdgrasp")
