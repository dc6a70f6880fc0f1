"""Commands that read runs: `info`, `show`, `digest`, `verify`, `render`, `view`.

Also `methods`, which lists the search methods.
"""

import json
import os
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_coordinator.metrics.run_stats import outcome_words
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder, run_folders
from qdgrasp_coordinator.storage.run_folder import journal_digest as digest_of
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import EXTRAS, InputError, check_packages
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.text import aligned_text, printable
from qdgrasp_tools.campaign.summaries import campaign_objects, campaign_summary, table_lines
from qdgrasp_tools.cli import options
from qdgrasp_tools.cli.options import host_and_port
from qdgrasp_tools.local.progress import progress_display
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.report.run_report import report_table, row_report, run_summary
from qdgrasp_tools.verification.comparison import VerificationReport
from qdgrasp_tools.verification.verify import EngineComparison, choose_rows, compare_engine, verify_rows
from qdgrasp_tools.verification.wrong_rows import take_wrong_rows_back


def info(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run, or of a campaign.")],
    objects: Annotated[
        bool, typer.Option("--objects", help="Of a campaign: print a table of its objects.")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Say what a run is and what it has found, also while it goes on.

    Of a campaign it says how much of it is done, what its objects got, which got little and why, and how many
    were left out; with --objects each object has a line.

    Example: qdgrasp info runs/demo --json

    Example: qdgrasp info runs/parts --objects
    """
    is_campaign = JobFolder.is_job(directory) and (directory / CAMPAIGN).is_file()
    if objects and not is_campaign:
        raise InputError(f"{directory} holds no campaign, whose objects --objects lists.")
    if objects:
        shown = campaign_objects(JobFolder.open(directory))
        lines = "\n".join(printable(line) for line in table_lines(shown))
        echo(json.dumps(msgspec.to_builtins(shown)) if as_json else lines)
        return
    found = (
        campaign_summary(JobFolder.open(directory)) if is_campaign else run_summary(RunFolder.open(directory))
    )
    echo(json.dumps(msgspec.to_builtins(found)) if as_json else found.table)


def show(
    directory: options.RunDir,
    grasp: Annotated[int, typer.Option(metavar="N", min=0, help="The row's number in the journal, from 0.")],
    as_json: options.Json = False,
) -> None:
    """Print everything known about one grasp of a run, or about any other row of its journal.

    Rows are counted as the monitor's view in 3D counts them. Poses are in the object's centre-of-mass frame,
    quaternions in the order x, y, z, w.

    Example: qdgrasp show runs/demo --grasp 17
    """
    found = row_report(RunFolder.open(directory), grasp)
    echo(json.dumps(found) if as_json else report_table(found))


def digest(directory: options.RunDir) -> None:
    """Print one sha256 over the journal's rows in order.

    It does not depend on workers, batches, kills, hosts or time: two runs of one spec have the same.

    Example: qdgrasp digest runs/demo
    """
    with RunFolder.open(directory).journal() as journal:
        echo(digest_of(journal))


SAMPLE_ROWS = 100


def verify(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run, or of a campaign.")],
    sample: Annotated[
        int | None, typer.Option(metavar="N", min=1, help=f"How many rows; default {SAMPLE_ROWS}.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed draws other rows.")] = 0,
    every: Annotated[bool, typer.Option("--all", help="Evaluate every row again.")] = False,
    engine: Annotated[
        str | None, typer.Option(help="Compare verdicts on successes with this engine: bullet or mujoco.")
    ] = None,
    fix: Annotated[
        bool, typer.Option("--fix", help="Take back the first row that is wrong, and all behind it.")
    ] = False,
    workers: options.Workers = None,
    as_json: options.Json = False,
) -> None:
    """Evaluate recorded rows again, and compare every result with the recorded one, bit for bit.

    Rows are drawn from all runs in the folder, of each outcome as many as of any other, trials apart; each
    goes through its own prior, genome and trial. Where something differs, the rows and columns are named, and
    how this platform differs from the one that they were made on. Exit code 0: all the same; 1: not all.

    With --fix earlier rows of workers whose rows differ are evaluated again too. The first row that differs
    twice is taken back with all behind it, for the search has learned from it; `qdgrasp resume` continues.

    With --engine the commanded poses of successes of a run are simulated in another engine, and both verdicts
    of each written to engine-NAME.csv in its folder; they may differ, so that the exit code is 0. The table
    keeps what it has of other successes.

    Example: qdgrasp verify runs/demo --sample 500
    """
    if every and sample is not None:
        raise InputError("--all leaves nothing to --sample: give one of them.")
    if fix and engine is not None:
        raise InputError("--fix is for a run's own engine: leave out --engine, or --fix.")
    folders, said = run_folders([directory]), list[str]()
    for folder in folders if fix else ():
        folder.job.check_not_in_use()
    engines = [engine] if engine is not None else [folder.spec.engine for folder in folders]
    config = LocalJobConfig(options.worker_count(workers, *engines))
    most = None if every else sample or SAMPLE_ROWS
    samples = choose_rows(folders, most, seed) if engine is None else []
    rows = sum(len(each.numbers) for each in samples) if engine is None else most or 0
    with progress_display("verify", rows) as shown, lifetime("qdgrasp verify") as stop:
        found: VerificationReport | EngineComparison | None
        if engine is None:
            found = verify_rows(samples, config, shown, stop)
            said = take_wrong_rows_back(found, config, shown, stop) if fix and not found.is_same else []
        else:
            found = compare_engine(RunFolder.open(directory), engine, most, seed, config, shown, stop)
    if stop.is_set or found is None:
        raise typer.Exit(stop.exit_code)
    echo(json.dumps(msgspec.to_builtins(found)) if as_json else found.table)
    for sentence in said:
        echo(sentence, err=as_json)
    if isinstance(found, VerificationReport) and not found.is_same:
        raise typer.Exit(1)


def render(
    directory: options.RunDir,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="FILE", help="A picture (.png) or a film (.gif); its folder is made."
        ),
    ],
    grasp: Annotated[int, typer.Option(metavar="N", min=0, help="The row's number in the journal, from 0.")],
    force: options.Force = False,
) -> None:
    """Carry one evaluation of a run out again and draw it.

    Any row of the journal can be shown, also one that failed. A picture has the hand after closing, or as it
    was placed if it did not close; a film goes through all of it, 3.2 times slower than it was. The
    result is compared with the recorded one: where they differ that is said, and the exit code is 1.

    Example: qdgrasp render runs/demo --grasp 17 -o grasp.gif
    """
    from qdgrasp_tools.verification.replay import (  # what draws takes its time to load
        difference_reason,
        replay_target,
        write_evaluation,
    )

    output = OutFile(out, suffixes=(".png", ".gif"), force=force)
    output.check()
    shown = replay_target(RunFolder.open(directory), grasp)
    echo(f"replaying row {shown.number} of {directory}", err=True)
    with lifetime("qdgrasp render") as stop:
        unlike = write_evaluation(shown, output, stop)
        if stop.is_set:
            raise typer.Exit(stop.exit_code)
        if unlike:
            echo(difference_reason(shown, unlike), err=True)
    echo(f"{outcome_words(shown.outcome)}, row {shown.number}: drawn in {out}")
    if unlike:
        raise typer.Exit(1)


LOCAL_PAGE = "127.0.0.1:0"


def view(
    directories: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...", help="Folders of runs and campaigns, or ones that hold such folders."
        ),
    ],
    web: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT",
            show_default=False,
            help="Serve the page there; default: on loopback, at a port that is free.",
        ),
    ] = LOCAL_PAGE,
) -> None:
    """Look at the grasps of runs in the browser: in 3D, with filters, and the hand as it grasps.

    Runs may be finished or going on; nothing is changed. The page is there until Ctrl-C. Beyond loopback it
    wants a token, which is printed.

    Example: qdgrasp view runs/demo
    """
    host, port = host_and_port(web)
    check_packages("The page", *EXTRAS["monitor"])
    with lifetime("qdgrasp-view") as stop:
        from qdgrasp_tools.monitor.records import FolderIndex
        from qdgrasp_tools.monitor.web.server import folder_routes, serve

        def opened(address: str) -> None:
            echo(f"The grasps are at {address} until Ctrl-C.")
            if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
                typer.launch(address)

        serve(folder_routes(FolderIndex(directories)), host, port, "", stop, opened)
    raise typer.Exit(stop.exit_code)


METHOD_COLUMNS = ("name", "prior", "overlaps", "population", "generations_in_flight", "in_flight", "summary")


def methods(as_json: options.Json = False) -> None:
    """Name every search method with its prior and its defaults; the first is the default.

    Example: qdgrasp methods --json
    """
    table = [{column: getattr(entry, column) for column in METHOD_COLUMNS} for entry in METHODS.values()]
    lines = [METHOD_COLUMNS, *([str(value) for value in entry.values()] for entry in table)]
    echo(json.dumps(table) if as_json else aligned_text(lines, range(len(METHOD_COLUMNS))))
