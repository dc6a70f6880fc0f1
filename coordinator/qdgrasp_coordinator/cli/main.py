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
    run_commands,
)
from qdgrasp_coordinator.cli import object_commands as object_
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
    """Whatever the command, there are flags of its own before it."""


for command in (
    run_commands.run,
    run_commands.resume,
    inspection_commands.info,
    inspection_commands.digest,
    grasp_commands.evaluate,
    inspection_commands.coverage,
):
    app.command()(command)
app.command()(campaign_commands.campaign)
app.command()(campaign_commands.analyse)
app.command()(inspection_commands.show)
app.command()(inspection_commands.view)
app.command()(inspection_commands.render)
app.command()(inspection_commands.verify)
app.command()(grasp_commands.export)
app.command("import")(grasp_commands.import_)
app.command()(run_commands.rerank)
app.command()(campaign_commands.merge)
app.command()(campaign_commands.prune)
app.command()(inspection_commands.methods)
app.command()(machine_commands.doctor)
app.command()(machine_commands.bench)
app.command()(job_commands.jobs)
app.command()(job_commands.pause)
app.command("continue")(job_commands.continue_)
app.command()(job_commands.cancel)
app.command()(job_commands.drain)
app.add_typer(asset_commands.asset_app, name="asset")
app.add_typer(gripper_commands.gripper_app, name="gripper")
app.add_typer(object_.object_app, name="object")
app.add_typer(inspection_commands.reference_app, name="reference")
app.add_typer(machine_commands.security_app, name="security")


def main() -> None:
    """Entry point of `qdgrasp`."""
    configure_logging("qdgrasp", level=logging.WARNING)
    run_command(app, "qdgrasp")
