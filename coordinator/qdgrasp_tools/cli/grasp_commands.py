"""`qdgrasp export`, `import` and `evaluate`: grasps in files of ours and of other tools."""

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_coordinator.metrics.successes import TrialPlan
from qdgrasp_coordinator.scheduler.run_plan import prepare_scene
from qdgrasp_coordinator.search.fixed_poses import read_poses, write_scores
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import run_folders
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.spec import RunSpec, run_spec, usual_engine
from qdgrasp_protocol.text import counted
from qdgrasp_tools.cli import options
from qdgrasp_tools.cli.run_commands import FINALISTS, scored_run
from qdgrasp_tools.export.arm import Arm, Pose6
from qdgrasp_tools.local.progress import progress_display, progress_messages
from qdgrasp_tools.local.supervisor import LocalJobConfig, check_engines, score_genomes

if TYPE_CHECKING:
    from qdgrasp_tools.export.importer import ImportedPoses


NO_OFFSET = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@options.spec_flags("approach_distance", "resting_pose", *options.LIMITS, sets=())
def export(
    keys: dict[str, Any],
    directories: Annotated[
        list[Path], typer.Argument(metavar="DIRS...", help="Folders of runs and of campaigns.")
    ],
    name: Annotated[
        str,
        typer.Option(
            "--format",
            help="One of isaac, acronym, graspgen, parquet, webdataset, moveit, csv, dexgraspbench, "
            "molmospaces, curobo, bundle.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="OUT",
            help="The file; for graspgen, dexgraspbench, bundle and several runs a folder.",
        ),
    ],
    min_fitness: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=6,
            metavar="N",
            help="Disturbances survived, at least; 0: all successes; default: all under physical, else 1.",
        ),
    ] = None,
    min_quality: Annotated[
        float,
        typer.Option(
            "--min-confidence",
            "--min-quality",
            min=0,
            max=1,
            metavar="Q",
            help="Least confidence: eta, or the share of disturbances survived.",
        ),
    ] = 0.0,
    top: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Only the N best: by eta, else fitness, motion.")
    ] = None,
    diverse: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Only N, spread as far as can be; of the best if --top."),
    ] = None,
    verify_top: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Score the N best first, as `rerank` does, and write the best of these."
        ),
    ] = None,
    holds_in: Annotated[
        str | None,
        typer.Option(
            metavar="ENGINE",
            help="Only grasps that hold in this engine too, by `verify --engine` (bullet, mujoco).",
            rich_help_panel=options.CHOICE,
        ),
    ] = None,
    frame: Annotated[
        str, typer.Option(help="Where poses are told: the object's mesh file (mesh) or centre of mass (com).")
    ] = "mesh",
    arm: Annotated[
        Path | None,
        typer.Option(metavar="URDF", help="Write also whether this arm comes to each pose, and its joints."),
    ] = None,
    base: Annotated[
        Pose6 | None,
        typer.Option(metavar="X Y Z R P Y", help="Its root link in the --frame [m, rad]."),
    ] = None,
    flange: Annotated[
        str | None, typer.Option(help="Its link with the hand; default: the hand's own, or the last.")
    ] = None,
    flange_to_hand: Annotated[
        Pose6, typer.Option(metavar="X Y Z R P Y", help="The hand's root link on the flange [m, rad].")
    ] = NO_OFFSET,
    reachable: Annotated[bool, typer.Option("--reachable", help="Only grasps that it comes to.")] = False,
    negatives: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Failures written too, at most; default: all in graspgen, else 0."
        ),
    ] = None,
    force: options.Force = False,
) -> None:
    """Write the grasps of a run to a file that other tools read,
    or those of several runs and campaigns to one data set.

    Every file says in which frames its poses are, the order of quaternions, scale, what success means, and
    under which licence the assets are. A run in progress gives what it has recorded by now. With
    --approach-distance or --resting-pose those grasps are written that the open hand comes to, with the way
    that it comes, as of a run that was asked for that. With --verify-top the N best grasps are evaluated in
    10 disturbed trials each, and the --top best of these (100) in 120, as a run of their own,
    runs/RUN-robust, of which the file then is. With --arm tables have the columns reachable and arm_joints,
    and --reachable leaves out what that arm does not come to. Of several runs, or of a campaign, OUT is a
    folder with an index and a card; flags choose from each run.

    Example: qdgrasp export runs/mug --verify-top 600 --format isaac -o grasps.yaml

    Example: qdgrasp export runs/mug-s0 runs/mug-s1 runs/campaign --format parquet -o grasps
    """  # noqa: D205  # typer joins the lines
    from qdgrasp_tools.export import exporter  # takes its time to load
    from qdgrasp_tools.export.grasp_reader import GraspChoice
    from qdgrasp_tools.export.grasp_table import frame_of

    limits, folders, carrier = options.grasp_limits(keys), run_folders(directories), None
    if (arm is None) != (base is None) or (reachable and arm is None):
        raise InputError("--arm and --base go together, and --reachable with them: give both, or none.")
    if arm is not None and base is not None:
        hand = folders[0].scene().gripper.base_link
        carrier = Arm(arm, frame_of(frame), base, hand, flange, flange_to_hand)
    choice = GraspChoice(
        min_fitness, min_quality, top, diverse, limits, holds_in, arm=carrier, reachable=reachable, **keys
    )
    is_one = len(directories) == 1 and [folder.path for folder in folders] == directories
    if verify_top is not None:
        if not is_one:
            raise InputError("--verify-top scores the grasps of one run; name one, or leave it out.")
        exporter.format_of(name)
        folders = [scored_run(folders[0], limits, top or FINALISTS, verify_top, **keys)]
    source = folders[0] if is_one else folders
    with progress_messages() as tell:
        written = exporter.export_grasps(
            source, out, name, choice, frame=frame, negatives=negatives, force=force, tell=tell
        )
    echo(written)


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="ACRONYM, GraspGen JSON, Isaac Grasp YAML, or Parquet of ours.",
        ),
    ],
    gripper: Annotated[str, typer.Option(help="Gripper: a built-in name or a TOML file.")],
    object_: Annotated[str, typer.Option("--object", help="Object: a built-in name or a mesh file.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="OUT", help="The poses: an npz file for `evaluate`; its folder is made."
        ),
    ],
    units: options.Units = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Where poses are told, mesh or com; default: as the file says, else mesh."),
    ] = None,
    flip_jaw: Annotated[
        bool,
        typer.Option(
            "--flip-jaw",
            help="For ACRONYM and GraspGen files whose jaw points the other way: turned by +90 degrees from "
            "the link of a Panda, not by -90.",
        ),
    ] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Take poses of a file that is of another hand or object.")
    ] = False,
    force: options.Force = False,
) -> None:
    """Turn a file of grasps, of ours or of others,
    into poses that `qdgrasp evaluate` scores again.

    The poses are those of the hand's root link in the object's centre-of-mass frame, as they are simulated.
    A file of ours that is of another hand or object is refused, unless --anyway is given.

    Example: qdgrasp import grasps.yaml --gripper panda --object mug -o poses.npz
    """  # noqa: D205  # typer joins the lines
    from qdgrasp_tools.export.grasp_table import frame_of
    from qdgrasp_tools.export.importer import import_poses, object_frame  # takes its time to load

    output = OutFile(out, force=force, inputs=(file, Path(gripper), Path(object_)))
    output.check()
    metres = options.scale_of_units(units)
    told_in = None if frame is None else frame_of(frame)
    with progress_messages() as tell:
        tell(f"reading {file}")
        hand = find_gripper(gripper).on_carrier("paper")
        found = import_poses(file, hand, object_frame(object_, metres), told_in, flip_jaw=flip_jaw)
    if found.mismatches and not anyway:
        said = " ".join(found.mismatches)
        raise InputError(f"{said} Name the hand and object of '{file}', or add --anyway.")
    found.write(output)
    for note in (*found.mismatches, *found.notes):
        echo(note, err=True)
    words = ["--gripper", gripper, "--object", object_, *(("--units", units) if units else ())]
    words += [*_conditions(found, object_), "--poses", str(out)]
    echo(f"{counted(len(found), 'pose')} written to {out}; this scores them:")
    echo(f"  qdgrasp evaluate {shlex.join([*words, '--out', str(out.with_name(f'{out.stem}-scores.npz'))])}")


def _conditions(found: "ImportedPoses", object_: str) -> Iterator[str]:
    """Yield the conditions under which the grasps were found, as flags."""
    about = found.imported.metadata
    spec = about.runs[0].asked if about and about.runs else RunSpec(gripper="", object="")
    mass = about.object_mass if about else found.imported.mass or "KG"
    if Path(object_).suffix or spec.mass is not None:
        yield from ("--mass", str(mass if Path(object_).suffix else spec.mass))
    friction = spec.friction if about else found.imported.friction
    yield from ("--protocol", spec.protocol if about else "physical")
    asked = {"base": spec.base, "engine": spec.engine, "friction": friction}
    for key, value in asked.items():
        if value not in (None, "paper"):
            yield from ("--set", f"{key}={value}")


@options.spec_flags("gripper", "object", "mass", "units", "mesh", "protocol", "engine", "resting_pose")
def evaluate(
    keys: dict[str, Any],
    poses: Annotated[Path, typer.Option(help="The poses: an npz file, see below.")],
    out: Annotated[Path, typer.Option(help="Where the scores go: an npz file; its folder is made.")],
    workers: options.Workers = None,
    force: options.Force = False,
) -> None:
    """Score given hand poses, in the object's centre-of-mass frame.

    The file holds base_position (n, 3) [m] and base_quaternion_xyzw (n, 4) of the hand's root link and,
    where the hand has them, synergy (n,) and spread (n, 2) [rad]; -1 and NaN mean none. Written are
    valid, touched, success (bool), fitness (uint8) and more, in the order that came: the settled pose, the
    object's motion, margin and contacts; with a protocol that has trials also eta, the share of their
    disturbances that was survived.

    Example: qdgrasp evaluate --gripper panda --object mug --poses poses.npz --out scores.npz
    """
    named = (Path(keys[each]) for each in ("gripper", "object") if each in keys)
    output = OutFile(out, force=force, inputs=(poses, *named))
    output.check()
    spec = run_spec(usual_engine(keys.get("protocol")) | keys, "evaluate")
    check_engines([spec])
    hand_poses = read_poses(poses)
    config = LocalJobConfig(options.worker_count(workers, spec.engine))
    with progress_display("evaluate", len(hand_poses)) as shown:
        shown.say(f"building the scene of {options.scene_words(spec)}")
        prepared = prepare_scene(spec)
        with lifetime("qdgrasp evaluate") as stop:
            genomes = hand_poses.genomes(prepared.scene)
            rows = score_genomes(spec, prepared, genomes, config, shown, stop)
    if stop.is_set:
        raise typer.Exit(stop.exit_code)
    with output.writing() as made:
        write_scores(made, rows, prepared.scene.object, TrialPlan.of(spec))
    echo(f"{counted(len(hand_poses), 'pose')} scored, written to {out}")
