"""The rival that a researcher writes in an hour, beside `qdgrasp run`: `python -m benchmarks.naive`.

Antipodal rays, MAP-Elites on an archive of pyribs, and PyBullet in a pool, for a Panda hand and an object.
Each command is a process with its workers, measured from a cold start in turns, A B A B; what it says to hold
is judged again by `physical` in MuJoCo. Figures are cells of 1 cm that hold, by CPU second of all
processes.
"""

import argparse
import json
import multiprocessing
import resource
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pybullet as pb
import trimesh
from numpy.typing import NDArray
from ribs.archives import GridArchive
from scipy.spatial.transform import Rotation

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.engines.bullet import OBJECT_URDF, write_body
from qdgrasp_worker.evaluator import Evaluator

Floats = NDArray[np.float64]
OPENING, REACH = 0.08, 0.1034  # Of the Panda's jaw, and from its base link to the fingertips [m]
FORCE, CLOSING, PUSH = 35.0, 120, 36  # Of a finger [N]; steps of 1/240 s
LOST = 0.05  # Way beyond which an object is lost [m]
BATCH, DRAWN = 100, 0.5  # Poses of a generation, and the share of them that is drawn anew
NEAR, TURN = 0.01, 0.2  # Standard deviations of mutations [m, rad]
PUSHES = np.concatenate([np.eye(3), -np.eye(3)])


def scene_of(thing: str) -> Scene:
    """The scene that judges, of the Panda and an object."""
    return build_scene(RunSpec(gripper="panda", object=thing, protocol="physical", engine="mujoco"))


class Simulator:
    """A hand and an object in PyBullet; lives in a process of the pool."""

    def __init__(self, thing: str) -> None:
        scene = scene_of(thing)
        pb.connect(pb.DIRECT)
        hand = scene_robot(scene.gripper).subtree(scene.gripper.base_link)
        texts = {
            "hand": (ET.tostring(hand.element, encoding="unicode"), scene.gripper.meshes),
            "object": (OBJECT_URDF.format(mass=scene.object.mass), {"parts.obj": scene.object.collision}),
        }
        with tempfile.TemporaryDirectory() as folder:
            self.hand, self.object = (
                pb.loadURDF(str(write_body(Path(folder) / name, *texts[name])), useFixedBase=name == "hand")
                for name in texts
            )
        kinds = [pb.getJointInfo(self.hand, i)[2] for i in range(pb.getNumJoints(self.hand))]
        self.fingers = [i for i, kind in enumerate(kinds) if kind == pb.JOINT_PRISMATIC]
        for link in (-1, *range(len(kinds))):
            pb.changeDynamics(self.hand, link, lateralFriction=1.0)
        pb.changeDynamics(
            self.object, -1, lateralFriction=scene.object.lateral_friction, spinningFriction=0.005
        )
        self.weight = 9.81 * scene.object.mass

    def __call__(self, pose: Floats) -> int:
        """Return the number of pushes that a pose (7,) of the hand survives, -1 where it overlaps."""
        pb.resetBasePositionAndOrientation(self.object, (0, 0, 0), (0, 0, 0, 1))
        pb.resetBaseVelocity(self.object, (0, 0, 0), (0, 0, 0))
        pb.resetBasePositionAndOrientation(self.hand, pose[:3], pose[3:])
        for finger in self.fingers:
            pb.resetJointState(self.hand, finger, OPENING / 2)
        if any(contact[8] < -0.001 for contact in pb.getClosestPoints(self.hand, self.object, 0.0)):
            return -1
        for finger in self.fingers:
            pb.setJointMotorControl2(
                self.hand, finger, pb.POSITION_CONTROL, 0.0, force=FORCE, maxVelocity=0.2
            )
        for _ in range(CLOSING):
            pb.stepSimulation()
        start, turn = np.array(pb.getBasePositionAndOrientation(self.object)[0]), Rotation.from_quat(pose[3:])
        for survived, push in enumerate(turn.apply(PUSHES * self.weight)):
            for _ in range(PUSH):
                place = pb.getBasePositionAndOrientation(self.object)[0]
                pb.applyExternalForce(self.object, -1, push, place, pb.WORLD_FRAME)
                pb.stepSimulation()
            apart = np.linalg.norm(pb.getBasePositionAndOrientation(self.object)[0] - start)
            if apart > LOST or not pb.getContactPoints(self.hand, self.object):
                return survived
        return len(PUSHES)


_simulator: Simulator


def begin(thing: str) -> None:
    """Make the simulator of this process."""
    global _simulator  # a pool's processes have no other place
    _simulator = Simulator(thing)


def simulate(pose: Floats) -> int:
    """Evaluate a pose (7,) in this process."""
    return _simulator(pose)


def antipodal_poses(mesh: trimesh.Trimesh, count: int, random: np.random.Generator) -> Floats:
    """Draw poses (n, 7) whose jaw closes along a ray through the object, at most `count`."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=random)
    inwards = -mesh.face_normals[faces]
    hits, rays, _ = mesh.ray.intersects_location(points + 1e-4 * inwards, inwards, multiple_hits=False)
    here, axes = points[rays], inwards[rays]
    fits = np.linalg.norm(hits - here, axis=1) < OPENING - 0.004
    here, hits, axes = here[fits], hits[fits], axes[fits]
    side = np.cross(axes, random.normal(size=axes.shape))
    approach = side / np.linalg.norm(side, axis=1, keepdims=True)
    turns = Rotation.from_matrix(np.stack([np.cross(axes, approach), axes, approach], axis=2))
    places = (here + hits) / 2 - approach * (REACH - random.uniform(0, 0.03, (len(axes), 1)))
    return np.hstack([places, turns.as_quat()])


def search(thing: str, evaluations: int, seed: int, workers: int) -> Floats:
    """Return the poses (n, 7) that MAP-Elites finds to hold."""
    scene, random = scene_of(thing), np.random.default_rng(seed)
    mesh = trimesh.Trimesh(scene.object.vertices, scene.object.mesh.faces, process=False)
    reach = float(np.abs(mesh.bounds).max()) + 0.2
    archive = GridArchive(
        solution_dim=7, dims=[int(200 * reach)] * 3, ranges=[(-reach, reach)] * 3, seed=seed
    )
    with multiprocessing.get_context("spawn").Pool(workers, begin, (thing,)) as pool:
        for _ in range(0, evaluations, BATCH):
            poses = antipodal_poses(mesh, BATCH if archive.empty else int(DRAWN * BATCH), random)
            if not archive.empty:
                parents = archive.sample_elites(BATCH - len(poses))["solution"]
                moved = parents[:, :3] + random.normal(0, NEAR, (len(parents), 3))
                turns = Rotation.from_rotvec(random.normal(0, TURN, moved.shape)) * Rotation.from_quat(
                    parents[:, 3:]
                )
                poses = np.vstack([poses, np.hstack([moved, turns.as_quat()])])
            scores = np.array(pool.map(simulate, poses, chunksize=10))
            found = scores >= 0
            archive.add(poses[found], scores[found], poses[found, :3])
    elites: dict[str, Any] = archive.data()
    return np.asarray(elites["solution"][elites["objective"] == len(PUSHES)])


def judged(thing: str, poses: Floats) -> int:
    """Return the number of cells of the poses (n, 7) that hold under `physical` in MuJoCo."""
    scene = scene_of(thing)
    genomes = np.zeros((len(poses), len(layout(scene, GIVEN))), dtype=np.float32)
    genomes[:, :7] = poses
    with Evaluator(scene) as evaluator:
        rows = evaluator.evaluate(GIVEN, genomes, np.zeros(len(poses), dtype=np.uint16)).rows
    held = rows[rows["outcome"] == Outcome.HELD]
    return len(np.unique(cell_keys(cells(held["base_to_object"][:, :3]))))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.naive", description=__doc__)
    parser.add_argument("--object", default="mug")
    parser.add_argument(
        "--evaluations", type=int, default=600, help="of qdgrasp; the rival has ten times as many"
    )
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--search", type=int, metavar="SEED", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.search is not None:
        poses = search(asked.object, 10 * asked.evaluations, asked.search, asked.workers)
        sys.stdout.write(json.dumps(poses.tolist()))
        return
    yields: dict[str, list[float]] = {}
    for seed in range(asked.rounds):
        for arm in ("script", "mujoco", "bullet"):
            found, seconds = carried_out(arm, seed, asked)
            count = judged(asked.object, found)
            yields.setdefault(arm, []).append(count / seconds)
            print(f"{arm}, seed {seed}: {count} cells that hold in {seconds:.1f} CPU s", flush=True)
    for arm, each in yields.items():
        ratio = median(np.divide(each, yields["script"]))
        print(f"{arm}: {median(each):.1f} cells that hold a CPU second, {ratio:.2f} of the script's")


def carried_out(arm: str, seed: int, asked: argparse.Namespace) -> tuple[Floats, float]:
    """Carry out the script, or a run in an engine; return poses (n, 7) that hold, and CPU seconds."""
    shared = [f"--object={asked.object}", f"--workers={asked.workers}", f"--evaluations={asked.evaluations}"]
    before = cpu_seconds()
    with tempfile.TemporaryDirectory() as folder:
        if arm == "script":
            command = ["-m", "benchmarks.naive", *shared, f"--search={seed}"]
        else:
            scene = ["--gripper=panda", "--protocol=physical", f"--engine={arm}", f"--seed={seed}"]
            command = ["-m", "qdgrasp", "run", *shared, *scene, f"--out={folder}/run"]
        said = subprocess.run([sys.executable, *command], check=True, capture_output=True).stdout
        seconds = cpu_seconds() - before
        if arm == "script":
            return np.array(json.loads(said)).reshape(-1, 7), seconds
        rows = RunFolder.open(Path(folder) / "run").successes().rows
    return rows["base_to_object"][rows["outcome"] == Outcome.HELD].astype(np.float64), seconds


def cpu_seconds() -> float:
    """CPU seconds of all processes that have ended below this one."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
