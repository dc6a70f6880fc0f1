"""`qdgrasp evaluate`: score hand poses that somebody else has found."""

from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_assets.units import scale_of
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.counts.poses import read_poses, write_scores
from qdgrasp_coordinator.folders.outputs import OutFile
from qdgrasp_coordinator.runs.preparation import make_bundle
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.scoring import score
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.spec import run_spec
from qdgrasp_protocol.trials import trials


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
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the scores if they are there.")] = False,
) -> None:
    """Score given hand poses, in the object's centre-of-mass frame.

    The file holds base_position (n, 3) [m] and base_quaternion_xyzw (n, 4) of the hand's root link and,
    where the hand has them, synergy (n,) and spread (n, 2) [rad]; -1 and NaN mean none. Written are
    valid, touched, success (bool), fitness (uint8) and more, in the order that came; with a protocol that has
    trials also eta, the share of their shakes that was survived.

    Example: qdgrasp evaluate --gripper panda --object mug --poses poses.npz --out scores.npz
    """
    values = {
        "gripper": gripper,
        "object": object_,
        "mass": mass,
        "scale": scale_of(units, scale),
        "friction": friction,
        "protocol": protocol,
    }
    if poses is None or out is None:
        missing = "--poses" if poses is None else "--out"
        raise InputError(f"{missing} is missing: name an npz file (`qdgrasp evaluate --help`).")
    named = (Path(each) for each in (gripper, object_) if each)
    output = OutFile(out, force=force, inputs=(poses, *named))
    output.check()
    spec = run_spec({name: value for name, value in values.items() if value is not None}, "evaluate")
    given = read_poses(poses)
    team = Team(options.cores() if workers is None else workers, batch_size)
    with display("evaluate", len(given)) as shown:
        shown.say(f"building the scene of {spec.gripper} and {spec.object}")
        scene, bundle = make_bundle(spec)
        with lifetime("qdgrasp evaluate") as stop:
            rows = score(spec, scene, bundle, given, team, shown, stop)
    if stop.is_set:
        raise typer.Exit(stop.exit_code)
    with output.writing() as made:
        write_scores(made, rows, trials(spec.protocol))
    typer.echo(f"{counted(len(given), 'pose')} scored, written to {out}")
