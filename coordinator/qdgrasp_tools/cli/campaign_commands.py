"""`qdgrasp campaign` and `analyse`: many runs, and their results."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.spec import STOP_KEYS, engine_names, usual_engine
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.campaign_file import campaign_of_meshes, check_meshes, read_campaign
from qdgrasp_tools.campaign.campaign_folder import begin_campaign, open_campaign
from qdgrasp_tools.campaign.object_library import LibraryRules, is_manifest
from qdgrasp_tools.campaign.summaries import campaign_summary
from qdgrasp_tools.cli import options
from qdgrasp_tools.cli.run_commands import check_not_stopped, echo_errors, resume_hint, run_job
from qdgrasp_tools.local.progress import progress_display, progress_messages
from qdgrasp_tools.local.supervisor import LocalJobConfig, check_engines


@options.spec_flags("units", "mesh", "protocol", "engine", "evaluations", "grasps")
def campaign(
    keys: dict[str, Any],
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE|DIR]", help="The campaign, a manifest, or the folder of one that began."
        ),
    ] = None,
    objects: Annotated[
        Path | None,
        typer.Option(metavar="DIR|FILE", help="In place of a file: a run of every mesh below a folder."),
    ] = None,
    gripper: Annotated[
        list[str] | None, typer.Option(help="For meshes: a built-in name or a TOML file; may be repeated.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option(help="For meshes: of each [kg] whose mass no table states.")
    ] = None,
    density: Annotated[
        float | None, typer.Option(min=1, help="For meshes: the same by volume [kg/m3]; water: 1000.")
    ] = None,
    skip_unusable: options.SkipUnusable = False,
    method: Annotated[
        list[str] | None, typer.Option(help="For meshes: search method; may be repeated.")
    ] = None,
    seed: Annotated[list[int] | None, typer.Option(help="For meshes: may be repeated; default 0.")] = None,
    out: Annotated[Path | None, typer.Option(help="The campaign's folder; default runs/FILE.")] = None,
    seconds: options.Seconds = None,
    workers: options.Workers = None,
    listen: options.Listen = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
    job: options.Job = None,
    list_runs: Annotated[bool, typer.Option("--list", help="Print the runs, and do nothing.")] = False,
) -> None:
    """Carry out all runs of a campaign;
    one that was stopped continues, and finished runs are not repeated.

    The file crosses grippers, objects, methods, seeds and any other keys of a spec; see docs/campaigns.md.
    Flags that end a run (--evaluations, --grasps, and --set of others) replace the file's [defaults]; a
    [[cross]] with its own keeps them. With --grasps an object with many grasps ends early, one with few
    continues to --evaluations, here 20000, or until it is saturated (saturation, here 0.1).

    A manifest (CSV or Parquet) names the objects of a library, with what they weigh and are; with --objects
    every mesh below a folder is grasped instead, whose masses are said for all. Both are campaigns of meshes,
    and take the options for meshes and all keys of a spec. With --skip-unusable the folder's skipped.csv
    names what is left out; see docs/objects.md.

    Example: qdgrasp campaign deploy/campaigns/paper-small.toml --out runs/paper-small

    Example: qdgrasp campaign --gripper panda --objects parts --units mm --density 1200 --out runs/parts
    """  # noqa: D205  # typer joins the lines
    goals = {key: keys.pop(key, None) for key in STOP_KEYS}
    crossed = options.given(gripper=gripper, method=method, seed=seed)
    if what is not None and is_manifest(what):
        if objects is not None:
            raise InputError(f"'{what}' is a manifest, and --objects is a library too: give one of them.")
        what, objects = None, what
    path = _campaign_folder(what, objects, out)
    with progress_messages() as tell:
        if objects is not None:
            if what is not None:
                raise InputError(f"--objects is a separate campaign: leave out '{what}', or --objects.")
            if None not in (mass, density):
                raise InputError("--mass and --density say the same of each object: give one of them.")
            rules = LibraryRules(
                mass=mass, density=density, scale=keys.pop("scale", None), mesh=keys.pop("mesh", None),
                skip_unusable=skip_unusable,
            )  # fmt: skip
            values = keys | crossed | goals
            asked = campaign_of_meshes(objects, rules, values, tell=tell)
        elif flags := keys | crossed | options.given(mass=mass, density=density):
            raise InputError(
                f"{next(iter(flags))} goes with --objects DIR or a manifest: a campaign's file says its "
                "own, see docs/campaigns.md."
            )
        elif what is None:
            raise InputError(
                "No campaign is named: give its file or its folder, or a folder of meshes with --objects."
            )
        else:
            begun = what.is_dir()  # and its file says the engine
            file = open_campaign(what).path / CAMPAIGN if begun else what
            asked = read_campaign(file, goals=goals, usual={} if begun else usual_engine())
    if list_runs:
        for name, spec in asked.runs.items():
            echo(f"{name}  {spec.evaluations}")
        for left_out in asked.skipped or ():
            echo(f"left out: {left_out.object}: {left_out.reason}")
        echo(asked.words)
        return
    if not JobFolder.is_job(path):
        with progress_messages() as tell:
            check_meshes(asked.runs.values(), tell)
    engines = {name for spec in asked.runs.values() for name in engine_names(spec.engine)}
    count = options.worker_count(workers, *engines)
    config = LocalJobConfig(count, listen, security, insecure, seconds, sorted(engines))
    check_engines(asked.runs.values(), config.workers)
    extent = begin_campaign(path, asked, job)
    folder = JobFolder(path)
    with lifetime("qdgrasp campaign") as stop, progress_display(path.name, asked.evaluations) as shown:
        shown.say(asked.words)
        if extent.runs_done:
            shown.say(f"{extent.runs_done} of {counted(extent.runs, 'run is', 'runs are')} finished already")
        if extent.runs_done < extent.runs:
            run_job(folder, config, shown, stop)
    check_not_stopped(folder, stop)
    print_summary(folder, is_timed=seconds is not None)


def _campaign_folder(what: Path | None, objects: Path | None, out: Path | None) -> Path:
    if what is None or not what.is_dir():
        return out or Path("runs") / (what or objects or Path()).absolute().stem
    if out is not None:
        raise InputError(f"{what} is a campaign's folder, and continues where it is; leave --out out.")
    return what


def print_summary(folder: JobFolder, *, is_timed: bool) -> None:
    """Print what the campaign's runs have recorded, finished or not; exit if it is not finished.

    `is_timed`: it was to end after some seconds, so that this is no failure.
    """
    found = campaign_summary(folder)
    echo(found.table)
    echo(f"`qdgrasp analyse {folder.path}` draws the figures.")
    echo_errors(found.errors, str(folder.path))
    if found.runs_done < found.runs:
        echo(f"Not all runs are finished; {resume_hint(folder)}")
        if not is_timed:
            raise typer.Exit(EndedEarly.exit_code)


def analyse(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="A campaign's folder, or any folder of run folders.")
    ],
    out: Annotated[Path | None, typer.Option(help="Where to write; default DIR/analysis.")] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option(help="A reference set of one's own; may be given again. The published ones need none."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Draw and tabulate what the runs of a campaign found.

    Writes the paper's four figures of results as PNG and SVG, `runs.csv` and `curves.csv`, and prints what
    each method reached with 95 % intervals; also while runs go on. Runs that repeat a search are left out.

    Example: qdgrasp analyse campaigns/paper-small
    """
    from qdgrasp_tools.report.report import REPORT_FOLDER, write_report  # matplotlib takes its time

    found = write_report(directory, out or directory / REPORT_FOLDER, reference or ())
    if as_json:
        values = {"out": str(found.out), "runs": len(found.runs), "unfinished": found.unfinished}
        echo(json.dumps(values | {"left_out": found.left_out, "repeats": found.repeats}))
        return
    echo(found.table)
    if found.repeats:
        echo(f"Left out, as others are of the same search: {', '.join(found.repeats)}.")
    mark = f", {found.unfinished} of them unfinished" if found.unfinished else ""
    echo(f"{counted(len(found.runs), 'run')}{mark}. Figures and tables: {found.out}")
