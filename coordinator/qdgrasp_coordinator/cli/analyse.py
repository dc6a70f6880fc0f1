"""`qdgrasp analyse`: the figures and tables of a campaign."""

import json
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_protocol.phrases import counted


def analyse(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="A campaign's folder, or any folder of run folders.")
    ],
    out: Annotated[Path | None, typer.Option(help="Where to write; default DIR/analysis.")] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option(help="A reference set of one's own; may be given again. The published ones need none."),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(help="Whose cells are drawn; default: the default method, or what found the most."),
    ] = None,
    log: Annotated[bool, typer.Option("--log", help="Curves on logarithmic axes.")] = False,
    as_json: options.Json = False,
) -> None:
    """Draw and tabulate what the runs of a campaign found, and hold the paper's claims against them.

    Writes four figures as PNG, SVG and CSV, and the tables as Markdown and CSV; also while runs go on. Runs
    that keep too little for curves, as pruned ones may, are left out and named.

    Example: qdgrasp analyse campaigns/paper-small
    """
    from qdgrasp_coordinator.analysis.page import left_out
    from qdgrasp_coordinator.analysis.report import OUT, report  # matplotlib takes its time

    found = report(directory, out or directory / OUT, references=reference or (), method=method, log=log)
    verdicts = {one.claim.letter: one.verdict.value for one in found.claims}
    if as_json:
        values = {"out": str(found.out), "runs": found.runs, "unfinished": found.unfinished}
        missing = {"left_out": found.left_out, "without_curves": found.without_curves}
        typer.echo(json.dumps({**values, "claims": verdicts, **missing}))
        return
    for one in found.claims:
        typer.echo(f"({one.claim.letter}) {one.claim.words}: {one.words}.")
    if found.without_curves:
        typer.echo(left_out(found.without_curves))
    mark = f", {found.unfinished} of them unfinished" if found.unfinished else ""
    typer.echo(f"{counted(found.runs, 'run')}{mark}. Figures and tables: {found.out / 'tables.md'}")
