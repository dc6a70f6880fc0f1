"""`qdgrasp export`, `import` and `evaluate`: grasps in files of ours and of other tools."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from qdgrasp_assets.geometry.mesh_io import scale_of
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan
from qdgrasp_coordinator.scheduler.run_plan import prepare_scene
from qdgrasp_coordinator.search.fixed_poses import read_poses, write_scores
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.spec import RunSpec, run_spec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.cli import options
from qdgrasp_tools.local.progress import progress_display, progress_messages
from qdgrasp_tools.local.session import score_poses
from qdgrasp_tools.local.supervisor import LocalJobConfig, check_engines

if TYPE_CHECKING:
    from qdgrasp_tools.export.importer import ImportedPoses


def export(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A run's folder, or a campaign's.")],
    name: Annotated[
        str,
        typer.Option("--format", help="One of isaac, acronym, graspgen, parquet, webdataset, moveit, csv."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="OUT",
            help="The file, for graspgen and campaigns a folder; those that it lies in are made.",
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
        int | None, typer.Option(min=1, metavar="N", help="Only the N best: by eta, fitness, margin.")
    ] = None,
    diverse: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Only N, spread as far as can be; of the best if --top."),
    ] = None,
    max_penetration: options.MaxPenetration = None,
    max_motion: options.MaxMotion = None,
    min_margin: options.MinMargin = None,
    min_links: options.MinLinks = None,
    holds_in: options.HoldsIn = None,
    approach_distance: options.ApproachDistance = None,
    resting_pose: options.RestingPoseOption = None,
    frame: Annotated[
        str, typer.Option(help="Where poses are told: the object's mesh file (mesh) or centre of mass (com).")
    ] = "mesh",
    negatives: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Failures written too, at most; default: all in graspgen, else 0."
        ),
    ] = None,
    meshes: Annotated[
        str | None, typer.Option(metavar="copy|name", help="Of a campaign: copy meshes; default: name them.")
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(metavar="SHARES", help="Of a campaign: share objects out, as in 80,10,10 (train, ...)."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Write the grasps of a run to a file that other tools read,
    or those of all runs of a campaign to one data set.

    Every file says which frames its poses are told in, the order of quaternions, scale, what success means,
    and under which licence the assets are. A run that goes on gives what it has recorded by now. With
    --approach-distance or --resting-pose those grasps are written that the open hand comes to, with the way
    that it comes, as of a run that was asked for that. Of a
    campaign OUT is a folder with an index and a card; flags choose from each run. If that is ended before,
    the same command goes on.

    Example: qdgrasp export runs/demo --format isaac -o grasps.yaml
    """  # noqa: D205  # typer joins the lines
    from qdgrasp_coordinator.metrics.grasp_quality import GraspLimits
    from qdgrasp_tools.export.exporter import export_run  # takes its time to load
    from qdgrasp_tools.export.grasp_reader import GraspChoice

    limits = GraspLimits(max_penetration, max_motion, min_margin, min_links)
    pose = options.resting_pose(resting_pose)
    if JobFolder.is_job(directory) and JobFolder(directory).is_campaign:
        from qdgrasp_tools.campaign import campaign_export  # takes its time to load

        choice = GraspChoice(
            min_fitness, min_quality, top, diverse, limits, holds_in, approach_distance, pose
        )
        shares = () if split is None else campaign_export.parse_shares(split)
        with progress_messages() as tell, lifetime("qdgrasp export") as stop:
            written = campaign_export.export_campaign(
                directory,
                out,
                name,
                choice,
                frame=frame,
                negatives=negatives,
                meshes=meshes or campaign_export.NAME,
                shares=shares,
                force=force,
                tell=tell,
                is_stopped=lambda: stop.is_set,
            )
        if not written:
            echo(f"Stopped. Complete files are in {out}.part; the same command goes on.", err=True)
            raise typer.Exit(stop.exit_code)
        echo(written)
        return
    if meshes is not None or split is not None:
        raise InputError("--meshes and --split are for a campaign's folder; leave them out.")
    with progress_messages() as tell:
        written = export_run(
            RunFolder.open(directory),
            out,
            name,
            min_fitness=min_fitness,
            min_quality=min_quality,
            top=top,
            diverse=diverse,
            limits=limits,
            holds_in=holds_in,
            approach_distance=approach_distance,
            resting_pose=pose,
            frame=frame,
            negatives=negatives,
            force=force,
            tell=tell,
        )
    echo(written)


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="ACRONYM, GraspGen JSON, Isaac Grasp YAML, or Parquet of ours, also a data set's folder.",
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
    scale: options.Scale = None,
    units: options.Units = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Where poses are told, mesh or com; default: as the file says, else mesh."),
    ] = None,
    of: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The object in a data set; default: as --object is called."),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Take poses of a file that is of another hand or object.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Turn a file of grasps, of ours or of others,
    into poses that `qdgrasp evaluate` scores again.

    The poses are those of the hand's root link in the object's centre-of-mass frame, as they are simulated.
    A file of ours that is of another hand or object is refused, unless --anyway is given.

    Example: qdgrasp import grasps.yaml --gripper panda --object mug -o poses.npz
    """  # noqa: D205  # typer joins the lines
    from qdgrasp_tools.campaign.campaign_export import asset_name, is_dataset  # takes its time to load
    from qdgrasp_tools.export.frames import frame_of
    from qdgrasp_tools.export.importer import hand_named, hand_notes, import_poses, object_frame

    output = OutFile(out, force=force, inputs=(file, Path(gripper), Path(object_)))
    output.check()
    metres = scale_of(units, scale)
    told_in = None if frame is None else frame_of(frame)
    with progress_messages() as tell:
        tell(f"reading {file}")
        name = of or (asset_name(object_) if is_dataset(file) else "")
        found = import_poses(file, hand_named(gripper), object_frame(object_, metres), told_in, name)
    if found.mismatches and not anyway:
        said = " ".join(found.mismatches)
        raise InputError(f"{said} Name the hand and object of '{file}', or add --anyway.")
    flags = {"gripper": gripper, "object": object_, "scale": metres} | _conditions(found, object_)
    flags |= {"poses": out, "out": out.with_name(f"{out.stem}-scores.npz")}
    found.write(output)
    for note in (*found.mismatches, *found.notes, *hand_notes(gripper, found.imported.metadata)):
        echo(note, err=True)
    words = [word for name, value in options.given(**flags).items() for word in (f"--{name}", str(value))]
    echo(f"{counted(len(found), 'pose')} written to {out}; this scores them:")
    echo(f"  qdgrasp evaluate {shlex.join(words)}")


def _conditions(found: "ImportedPoses", object_: str) -> dict[str, object]:
    """Return the conditions under which the grasps were found, as flags."""
    about = found.imported.metadata
    spec = about.runs[0].asked if about and about.runs else RunSpec(gripper="", object="")
    mass = about.object_mass if about else found.imported.mass or "KG"
    return {
        "mass": mass if Path(object_).suffix else spec.mass,
        "friction": spec.friction if about else found.imported.friction,
        "protocol": None if spec.protocol == "paper" else spec.protocol,
        "base": None if spec.base == "paper" else spec.base,
        "engine": spec.engine,
    }


def evaluate(
    gripper: options.Gripper = None,
    object_: options.Object = None,
    poses: Annotated[Path | None, typer.Option(help="The poses: an npz file, see below.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Where the scores go: an npz file; its folder is made.")
    ] = None,
    mass: options.Mass = None,
    scale: options.Scale = None,
    units: options.Units = None,
    friction: options.Friction = None,
    protocol: options.ProtocolOption = None,
    base: options.BaseOption = None,
    engine: options.EngineOption = None,
    approach_distance: options.ApproachDistance = None,
    resting_pose: options.RestingPoseOption = None,
    workers: options.OwnWorkers = None,
    batch_size: options.BatchSize = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the scores if they are there.")] = False,
) -> None:
    """Score given hand poses, in the object's centre-of-mass frame.

    The file holds base_position (n, 3) [m] and base_quaternion_xyzw (n, 4) of the hand's root link and,
    where the hand has them, synergy (n,) and spread (n, 2) [rad]; -1 and NaN mean none. Written are
    valid, touched, success (bool), fitness (uint8) and more, in the order that came; with a protocol that has
    trials also eta, the share of their disturbances that was survived.

    Example: qdgrasp evaluate --gripper panda --object mug --poses poses.npz --out scores.npz
    """
    values = options.given(
        gripper=gripper,
        object=object_,
        mass=mass,
        scale=scale_of(units, scale),
        friction=friction,
        protocol=protocol,
        base=base,
        engine=engine,
        approach_distance=approach_distance,
        resting_pose=options.resting_pose(resting_pose),
    )
    if poses is None or out is None:
        missing = "--poses" if poses is None else "--out"
        raise InputError(f"{missing} is missing: name an npz file (`qdgrasp evaluate --help`).")
    named = (Path(each) for each in (gripper, object_) if each)
    output = OutFile(out, force=force, inputs=(poses, *named))
    output.check()
    spec = run_spec(values, "evaluate")
    check_engines([spec])
    hand_poses = read_poses(poses)
    config = LocalJobConfig(options.worker_count(workers, spec.engine), batch_size)
    with progress_display("evaluate", len(hand_poses)) as shown:
        shown.say(f"building the scene of {spec.gripper} and {spec.object}")
        prepared = prepare_scene(spec)
        with lifetime("qdgrasp evaluate") as stop:
            rows = score_poses(spec, prepared, hand_poses, config, shown, stop)
    if stop.is_set:
        raise typer.Exit(stop.exit_code)
    with output.writing() as made:
        write_scores(made, rows, TrialPlan.of(spec))
    echo(f"{counted(len(hand_poses), 'pose')} scored, written to {out}")
