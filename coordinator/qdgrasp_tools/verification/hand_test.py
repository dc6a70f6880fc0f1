"""Closes a guessed hand on a ball and a box that fit it, in the simulator.

Poses are those of the prior approach, half of them from nearly straight above, and are evaluated as in a run.
"""

import tempfile
from pathlib import Path

import numpy as np

from qdgrasp_assets.genes import layout
from qdgrasp_assets.gripper_setup.closing_motion import ClosingMotion
from qdgrasp_assets.gripper_setup.hand_verdict import HandVerdict, fitting_sizes
from qdgrasp_assets.grippers.collision_shapes import check_convex
from qdgrasp_assets.grippers.gripper import Gripper
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import NamedRunQueue, RunPlan, plan_genomes, prepare_scene
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.spec import run_spec, usual_engine
from qdgrasp_tools.local.progress import progress_display
from qdgrasp_tools.local.supervisor import LocalJobConfig, run_temporary_job

POSES = 80  # Poses over each object
NU, NEAR_NORMAL = 3, 0.25  # Place of the gene of the approach cone's angle; share of it for half of the poses
MASS = 0.05  # Of each object [kg]


def try_hand(hand: Gripper, path: Path, closing: ClosingMotion, stop: Stop) -> HandVerdict | None:
    """Close the hand of the file at `path` on both objects; None where a signal came first.

    It is simulated in MuJoCo, or in Bullet if that alone takes its shapes. Raises as `run_temporary_job`.
    """
    carried, engine = hand.on_carrier("physical"), {"engine": "mujoco"}
    try:
        check_convex(carried)
    except AssetError:
        engine = usual_engine()
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as folder:
        values = {"gripper": str(path), "protocol": "physical", **engine}
        sizes = fitting_sizes(closing, hand.file)
        plans = {name: _plan(values, name, size, Path(folder)) for name, size in sizes.items()}
    sinks = {name: RowSink(plan.shape) for name, plan in plans.items()}
    queue, config = NamedRunQueue(plans.__getitem__, dict.fromkeys(plans, POSES)), LocalJobConfig(workers=1)
    with progress_display("closing on a ball and a box", len(plans) * POSES) as shown:
        run_temporary_job("hand-test", queue, lambda plan: sinks[plan.run], config, shown, stop)
    rows = np.concatenate([sink.rows for sink in sinks.values()])
    return None if stop.is_set else HandVerdict(closing, hand.file, carried.links, rows)


def _plan(values: dict[str, str], name: str, size: float, folder: Path) -> RunPlan:
    """Return the run of one object, whose mesh is written to a folder."""
    import trimesh  # takes its time to load

    box = (size, 0.8 * size, 1.2 * size)
    solid = trimesh.creation.box(box) if name == "box" else trimesh.creation.icosphere(3, size / 2)
    solid.export(folder / f"{name}.stl")
    spec = run_spec({**values, "object": str(folder / f"{name}.stl"), "mass": MASS})
    prepared = prepare_scene(spec)
    genomes = np.random.default_rng(0).uniform(-1, 1, (POSES, len(layout(prepared.scene, "approach"))))
    genomes[::2, NU] = NEAR_NORMAL * (genomes[::2, NU] + 1) - 1
    return plan_genomes(spec, prepared, "approach", genomes.astype(np.float32), name)
