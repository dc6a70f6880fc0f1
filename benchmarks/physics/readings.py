"""Verdicts of `paper` where the paper's text is read otherwise: `python -m benchmarks.physics.readings`.

Poses are successes in `paper`, drawn as in `benchmarks.physics`. Each is evaluated with one thing changed at
a time: shakes along z and about x of the object, whose axes are the world's; a translation with the force to
reach both of its targets, which makes it faster too; a second shake after a lost first one; and a friction of
the pair of 0.5. Of each reading the table says which share is held, and which has the same fitness. The last
columns are of `paper` itself: successes whose fingers touch without a force, and those whose hand stands in
another cell of 1 cm when it has closed.
"""

import argparse
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import islice

import msgspec
import numpy as np
from benchmarks.physics.__main__ import poses_of, scene_of
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.geometry.rotation import conjugate, rotate
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import EpisodeResult, ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PAPER, EvaluationProtocol, TrialSetup

HANDS = ("panda", "barrett", "allegro")
OBJECTS = ("ycb_rubiks_cube", "ycb_mug")
STRONG = 30.0  # Factor of the force of the translation, which then comes to 19 cm either way
PAIR = 2.0  # Factor of the object's friction that makes the pair's 0.5
OBJECT_AXES = {"translationZ": (0.0, 0.0, 1.0), "rotationX": (1.0, 0.0, 0.0)}


class UnsweptWorld(BulletShakenWorld):
    """A world that is quickly made, in which closing goes on to the end."""

    def measure_sweep(self, *_: object) -> None:  # type: ignore[override]
        """Skip the measurement."""


def evaluated(
    scene: Scene,
    poses: Sequence[HandPose],
    protocol: EvaluationProtocol = PAPER,
    grip: float = 1.0,
) -> list[EpisodeResult]:
    """The results of poses in one world."""
    with closing(UnsweptWorld(scene)) as world:
        episode = ShakenEpisode(world, protocol, stops_early=False)
        return [episode.run(TrialSetup(pose, grip=grip)) for pose in poses]


def along_object(scene: Scene, pose: HandPose) -> Scene:
    """The scene with a carrier whose axes at this pose are the object's."""
    robot = ET.fromstring(scene.gripper.urdf)  # noqa: S314  # the scene's own
    for name, axis in OBJECT_AXES.items():
        seen = rotate(conjugate(np.array(pose.quaternion)), np.array(axis))
        element = robot.find(f"joint[@name='{name}']/axis")
        assert element is not None
        element.set("xyz", " ".join(f"{part:.9g}" for part in seen))
    urdf = ET.tostring(robot, encoding="unicode")
    return msgspec.structs.replace(scene, gripper=msgspec.structs.replace(scene.gripper, urdf=urdf))


def with_strength(scene: Scene, factor: float) -> Scene:
    """The scene with a translation of more force."""
    carrier = tuple(
        msgspec.structs.replace(joint, shake_force=joint.shake_force * (factor if joint.shake == "z" else 1))
        for joint in scene.gripper.carrier
    )
    return msgspec.structs.replace(scene, gripper=msgspec.structs.replace(scene.gripper, carrier=carrier))


def successes(scene: Scene, n: int, seed: int) -> tuple[list[HandPose], list[EpisodeResult]]:
    """The first poses that are a success in `paper`, with their results."""
    with closing(BulletShakenWorld(scene)) as world:
        episode = ShakenEpisode(world, PAPER)
        evaluated = ((pose, episode.run(TrialSetup(pose))) for pose in poses_of(scene, seed))
        found = islice(((pose, result) for pose, result in evaluated if result.outcome.is_success), n)
        poses, results = zip(*found, strict=True)
    return list(poses), list(results)


def readings(scene: Scene, poses: Sequence[HandPose]) -> Iterator[tuple[str, list[EpisodeResult]]]:
    """Each reading's results of the same poses."""
    yield "object's axes", [evaluated(along_object(scene, pose), [pose])[0] for pose in poses]
    yield "both targets", evaluated(with_strength(scene, STRONG), poses)
    yield "both shakes", evaluated(scene, poses, replace(PAPER, ends_when_lost=False))
    yield "pair 0.5", evaluated(scene, poses, grip=PAIR)


def share(found: Sequence[bool]) -> str:
    """A share as text for the table."""
    return f"{np.mean(found):.2f}"


def is_pressing(scene: Scene, result: EpisodeResult) -> bool:
    """Whether a finger link touches with a force after closing."""
    fingers = set(scene.gripper.finger_links)
    return any(each.force > 0 and scene.gripper.links[each.link - 1] in fingers for each in result.contacts)


def figures(hand: str, target: str, n: int, seed: int) -> dict[str, str]:
    """The figures of a hand and an object."""
    scene = scene_of(hand, target, "paper")
    poses, base = successes(scene, n, seed)
    commanded = np.array([pose.position for pose in poses])
    settled = np.array([result.settled[:3] for result in base])
    row = {
        "hand": hand,
        "object": target.removeprefix("ycb_"),
        "poses": str(len(poses)),
        "fitness 0 / 1 / 2": " / ".join(share([one.fitness == k for one in base]) for k in range(3)),
    }
    for name, found in readings(scene, poses):
        same = share([one.fitness == other.fitness for one, other in zip(found, base, strict=True)])
        row[f"{name}: held, same"] = f"{share([one.outcome is Outcome.HELD for one in found])}, {same}"
    row["no force"] = share([not is_pressing(scene, result) for result in base])
    row["another cell"] = share((np.rint(100 * settled) != np.rint(100 * commanded)).any(axis=1).tolist())
    return row


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser("python -m benchmarks.physics.readings", description=__doc__)
    parser.add_argument("--hands", nargs="+", default=HANDS)
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    rows = [figures(hand, body, asked.poses, asked.seed) for hand in asked.hands for body in asked.objects]
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*row.values())
    Console(width=220).print(table)


if __name__ == "__main__":
    main()
