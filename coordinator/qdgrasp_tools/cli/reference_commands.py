"""Commands about reference sets: `coverage`, and `reference build` and `info`."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from qdgrasp_coordinator.metrics.reference_coverage import (
    UNKNOWN,
    ReferenceSet,
    is_stand_in,
    object_identity,
    read_reference,
    read_references,
    released_archive,
)
from qdgrasp_coordinator.metrics.reference_coverage import coverage as coverage_of
from qdgrasp_coordinator.metrics.richness import RichnessEstimate
from qdgrasp_coordinator.metrics.scores import survival
from qdgrasp_coordinator.storage.run_folder import RunFolder, provenances, run_digest
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.text import counted
from qdgrasp_tools.cli import options
from qdgrasp_tools.report.reference_builder import build_reference_sets as build_sets


def coverage(
    directory: options.RunDir,
    reference: Annotated[Path | None, typer.Option(help="The reference set, an npz file.")] = None,
    object_: Annotated[str | None, typer.Option("--object", help="The object's name in the set.")] = None,
    as_json: options.Json = False,
) -> None:
    """Say how much of a reference set of graspable positions a run has found.

    Counted are distinct success positions, rounded to 1 cm, that are in the set, over its size. Beside the
    coverage of a set of one's own stands an estimate of all cells, those that it lacks included.

    Example: qdgrasp coverage runs/demo --reference S_G_panda_2f.npz --object rubiks_cube
    """
    if reference is None or object_ is None:
        raise InputError(f"{'--reference' if reference is None else '--object'} is missing; see --help.")
    folder = RunFolder.open(directory)
    entries = read_reference(reference, object_)
    scene = folder.scene()
    stand_in = is_stand_in(folder.spec.object, object_identity(scene.object), entries)
    with folder.journal() as journal:
        successes = journal.successes()
        runs = {run_digest(run.spec, journal, run.rows) for run in provenances(folder, journal)}
    built_from = entries.origin is not None and not runs.isdisjoint(entries.origin.runs)
    positions = successes["base_to_object"][:, :3]
    found = coverage_of(positions, survival(successes), entries, released_archive(scene))
    if as_json:
        values = {"object": object_, "stand_in": stand_in, "built_from": built_from}
        echo(json.dumps(msgspec.to_builtins(found) | values))
        return
    stands_in = " The run is on a stand-in for the scan." if stand_in else ""
    echo(found.sentence + stands_in + (" The set was built from this run too." if built_from else ""))


reference_app = typer.Typer(
    name="reference",
    no_args_is_help=True,
    help="Reference sets of graspable positions: build them from runs.",
)
Complete = Annotated[
    float,
    typer.Option(metavar="SHARE", help="The share of the estimated cells that is enough, 0.999 at most."),
]
ENOUGH, MOST = 0.95, 0.999  # Such shares: as a default, and at most, as all of an estimate takes endless runs


@reference_app.command()
def build(
    directories: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Folders of runs.")],
    out: Annotated[Path, typer.Option(help="The reference set, an npz file; added to where it exists.")],
    name: Annotated[
        str | None, typer.Option(help="The object's name in the set; default: the run's, without ycb_.")
    ] = None,
    mixed: Annotated[bool, typer.Option("--mixed", help="Take runs under different protocols.")] = False,
    complete: Complete = ENOUGH,
    as_json: options.Json = False,
) -> None:
    """Gather the cells of all successes of runs, with the best fitness in each.

    One file holds the sets of one gripper. Runs may be added later, and again. From how many runs found each
    cell follows an estimate of the cells that none did, and whether the set is complete enough.

    Example: qdgrasp reference build runs/part-s0 runs/part-s1 --out S_G_part.npz
    """
    _check_share(complete)
    _print_sets(out, build_sets(map(RunFolder.open, directories), out, name, mixed=mixed), complete, as_json)


@reference_app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A reference set, an npz file.")],
    complete: Complete = ENOUGH,
    as_json: options.Json = False,
) -> None:
    """Say what the sets in a file hold, and how many cells they are estimated to lack.

    Example: qdgrasp reference info S_G_part.npz --complete 0.9
    """
    _check_share(complete)
    _print_sets(file, read_references(file), complete, as_json)


def _check_share(complete: float) -> None:
    if not 0 < complete <= MOST:
        raise ImpossibleValue("--complete", complete, f"more than 0 and at most {MOST}")


def _print_sets(file: Path, sets: Mapping[str, ReferenceSet], share: float, as_json: bool) -> None:
    if as_json:
        objects = {name: _values(known, share) for name, known in sets.items()}
        echo(json.dumps({"out": str(file), "objects": objects}))
        return
    for known in sets.values():
        echo("\n".join(_lines(file, known, share)))
    if not any(known.origin for known in sets.values()):
        echo(f"The file does not say in how many runs each cell was found, so that {UNKNOWN}.")


def _values(known: ReferenceSet, share: float) -> dict[str, Any]:
    """Return the values of a set in JSON: sizes, and estimates with what follows from a share."""
    runs = None if known.by_run is None else len(known.by_run)
    values: dict[str, Any] = {"size": len(known), "robust_size": len(known.robust), "runs": runs}
    for key, found in (("estimate", known.estimate), ("robust_estimate", known.robust.estimate)):
        values[key] = found and {
            **msgspec.to_builtins(found),
            "complete_enough": found.is_complete(share),
            "further_runs": found.further_runs(share),
        }
    return values


def _lines(file: Path, known: ReferenceSet, share: float) -> Iterator[str]:
    cells, robust = counted(len(known), "cell"), len(known.robust)
    runs = "" if known.by_run is None else f", from {counted(len(known.by_run), 'run')}"
    yield f"{file} holds {cells} of '{known.object}', {robust} of them robust{runs}."
    if known.estimate is not None:
        held = known.robust.estimate
        yield f"  All cells: {_judgement(known.estimate, share)}"
        yield f"  Robust cells: {_judgement(held, share) if held else 'none so far.'}"
    elif known.origin is not None:
        yield f"  {known.estimate_words()}"


def _judgement(found: RichnessEstimate, share: float) -> str:
    """Say how complete a set is estimated to be, and whether that is enough."""
    words = f"{found.seen} of {found.total_words()}, {found.completeness:.1%}:"
    if found.is_complete(share):
        return f"{words} complete enough for {100 * share:g}%."
    more = counted(found.further_runs(share), "more run")
    return f"{words} not complete enough; {100 * share:g}% would take about {more} like these."
