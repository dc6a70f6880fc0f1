"""`qdgrasp`: the table of its commands."""

import logging

import typer

from qdgrasp_coordinator.cli import (
    administer,
    analyse,
    asset,
    bench,
    campaign,
    coverage,
    digest,
    doctor,
    evaluate,
    export,
    gripper,
    import_,
    info,
    jobs,
    merge,
    methods,
    prune,
    reference,
    render,
    rerank,
    resume,
    run,
    security,
    show,
    verify,
    view,
)
from qdgrasp_coordinator.cli import object as object_
from qdgrasp_protocol import flags
from qdgrasp_protocol.command import run_command
from qdgrasp_protocol.logs import speak

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Archives of diverse, robust 6-DoF grasps by quality-diversity search.",
)


@app.callback()
def qdgrasp(version: flags.Version = False) -> None:
    """Whatever the command, there are flags of its own before it."""


for command in (run.run, resume.resume, info.info, digest.digest, evaluate.evaluate, coverage.coverage):
    app.command()(command)
app.command()(campaign.campaign)
app.command()(analyse.analyse)
app.command()(show.show)
app.command()(view.view)
app.command()(render.render)
app.command()(verify.verify)
app.command()(export.export)
app.command("import")(import_.import_)
app.command()(rerank.rerank)
app.command()(merge.merge)
app.command()(prune.prune)
app.command()(methods.methods)
app.command()(doctor.doctor)
app.command()(bench.bench)
app.command()(jobs.jobs)
app.command()(administer.pause)
app.command("continue")(administer.continue_)
app.command()(administer.cancel)
app.command()(administer.drain)
app.add_typer(asset.app, name="asset")
app.add_typer(gripper.app, name="gripper")
app.add_typer(object_.app, name="object")
app.add_typer(reference.app, name="reference")
app.add_typer(security.app, name="security")


def main() -> None:
    """Entry point of `qdgrasp`."""
    speak("qdgrasp", level=logging.WARNING)
    run_command(app, "qdgrasp")
