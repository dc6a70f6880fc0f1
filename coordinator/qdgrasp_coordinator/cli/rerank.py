"""`qdgrasp rerank`: score the best grasps of a run again, in trials."""

from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.diversity import synergies_of
from qdgrasp_coordinator.analysis.harvest import identity
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.carrying import carry_out
from qdgrasp_coordinator.cli.run import finish
from qdgrasp_coordinator.counts.niches import niches
from qdgrasp_coordinator.counts.poses import as_given
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.keeping.ranking import best, grasps, note_source
from qdgrasp_coordinator.runs import preparation
from qdgrasp_coordinator.searches.search import method
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Door, Team
from qdgrasp_protocol import flags
from qdgrasp_protocol.errors import InputError, UnknownName
from qdgrasp_protocol.genome import GIVEN
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import MOST, RunSpec, run_spec, to_values
from qdgrasp_protocol.trials import COUNTS


def rerank(
    directory: options.RunDir,
    protocol: Annotated[str, typer.Option(help="Evaluation protocol with trials.")] = "robust",
    top: Annotated[
        int, typer.Option(min=1, max=MOST, help="How many grasps; all where there are fewer.")
    ] = 100,
    by_niche: Annotated[
        bool, typer.Option("--niches", help="Take the best of each niche: cell, orientation and synergy.")
    ] = False,
    discard_table: Annotated[
        bool, typer.Option("--discard-table", help="Leave out hands that cut a table under the object.")
    ] = False,
    object_pose: Annotated[
        str | None,
        typer.Option(
            help="How the object stands on it: quaternion x,y,z,w or angles x,y,z [deg]; default: z up."
        ),
    ] = None,
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    listen: options.Listen = None,
    security: flags.Security = None,
    insecure: flags.Insecure = False,
    job: Annotated[str | None, typer.Option(help="Name on the bus; default: the folder's name.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder; default runs/<name of the run>-<protocol>.")
    ] = None,
    disk_wait: options.DiskWait = 60.0,
) -> None:
    """Score the best grasps of a run again, in many disturbed trials each, and rank them by eta.

    Taken is the best grasp of each cell or niche, and of these the best ones. The folder is that of a run:
    `qdgrasp resume` goes on with it, and workers may join. ranking.csv in it holds every grasp by eta.

    Example: qdgrasp rerank runs/demo --top 50 --discard-table --object-pose 90,0,0
    """
    if protocol not in COUNTS:
        raise UnknownName("protocol with trials", protocol, COUNTS)
    if object_pose is not None and not discard_table:
        raise InputError("--object-pose says how the object stands on a table: add --discard-table.")
    source = RunFolder.open(directory)
    folder = out or Path("runs") / f"{source.path.absolute().name}-{protocol}"
    RunFolder.check_free(folder)
    found = _grasps(source, (object_pose or "0,0,0") if discard_table else None)
    chosen = best(found, top, niches(found, synergies_of(source)) if by_niche else None)
    spec = spec_of(source, protocol, chosen)
    door = Door(listen, security, insecure)
    team = Team(options.cores() if workers is None else workers, batch_size, door, disk_wait)
    with display(folder.name, spec.evaluations) as shown:
        shown.say(f"scoring {counted(len(chosen), 'grasp')} of {directory} again")
        scene, bundle = preparation.make_bundle(spec)
        _check_same(source.scene(), scene)
        with lifetime("qdgrasp rerank") as stop:
            begun = RunFolder.create(folder, spec, bundle, job=job)
            note_source(begun, source, chosen)
            carry_out(begun.job, team, shown, stop)
    finish(begun, stop)


def _grasps(source: RunFolder, object_pose: str | None) -> Rows:
    """The grasps of a run, clear of a table if the object stands on one."""
    found = grasps(source)
    if not len(found):
        raise InputError(f"{source.path} has found no grasp (fitness 1 or more) that could be scored again.")
    if object_pose is not None:
        from qdgrasp_coordinator.analysis.table import orientation, table_under  # scipy takes its time

        scene = source.scene()
        table = table_under(scene, orientation(object_pose))
        found = found[table.is_clear_of(scene, method(source.spec.method).prior, found)]
    if not len(found):
        raise InputError(
            f"Every grasp in {source.path} would cut the table; turn the object with --object-pose."
        )
    return found


def spec_of(source: RunFolder, protocol: str, chosen: Rows) -> RunSpec:
    """The spec of a run that scores grasps of another."""
    genomes = as_given(source.scene(), method(source.spec.method).prior, chosen)
    poses = [[float(str(number)) for number in genome] for genome in genomes]  # the shortest decimals
    values = to_values(source.spec) | {
        "method": GIVEN,
        "protocol": protocol,
        "evaluations": len(poses),
        "population": len(poses),
        "generations_in_flight": 1,
        "overlaps": "count",
        "poses": poses,
    }
    return run_spec(values, "rerank")


def _check_same(old: Scene, new: Scene) -> None:
    """Check that poses in one scene mean the same in another: the same hand, and the same object."""
    hands = [msgspec.structs.asdict(scene.gripper) | {"carrier": None, "urdf": None} for scene in (old, new)]
    if identity(old.object) != identity(new.object) or hands[0] != hands[1]:
        raise InputError(
            f"'{new.gripper.name}' or '{new.object.name}' is not what it was when the run was made, so that "
            "its poses mean something else; restore their files."
        )
