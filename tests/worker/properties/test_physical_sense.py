"""Laws of mechanics that verdicts obey in any simulator."""

import numpy as np
import pytest
from msgspec.structs import replace
from tests.common import with_gripper
from tests.worker.genomes import decoded, draw

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PAPER, TrialSetup

POSES = 120
AGREEMENT = 0.95


def poses_of(scene, genomes) -> list[HandPose]:
    return list(decoded(scene, "approach", genomes))


def outcomes(world: BulletShakenWorld, poses: list[HandPose]) -> list[Outcome]:
    """The outcomes of the poses; the world is closed."""
    found = [ShakenEpisode(world, PAPER).run(TrialSetup(pose)).outcome for pose in poses]
    world.close()
    return found


def touching(scene, poses: list[HandPose]) -> tuple[list[HandPose], list[Outcome]]:
    """The first POSES poses that touch the object, half of them successes, with their outcomes."""
    world, successes, brushes = BulletShakenWorld(scene), [], []
    for pose in poses:
        outcome = ShakenEpisode(world, PAPER).run(TrialSetup(pose)).outcome
        if outcome >= Outcome.BRUSHED:
            (successes if outcome.is_success else brushes).append((pose, outcome))
        if min(len(successes), len(brushes)) >= POSES // 2:
            break
    world.close()
    chosen = successes[: POSES // 2] + brushes[: POSES // 2]
    assert len(chosen) == POSES
    return [pose for pose, _ in chosen], [outcome for _, outcome in chosen]


def agreement(found: list[Outcome], expected: list[Outcome]) -> float:
    """The share of poses that come to the same."""
    return float(np.mean(np.array(found) == np.array(expected)))


def mirrored_pose(pose: HandPose) -> HandPose:
    """The image of a pose in the plane x = 0, for a hand whose frame is mirrored likewise."""
    (px, py, pz), (x, y, z, w) = pose.position, pose.quaternion
    return HandPose([-px, py, pz], [x, -y, -z, w], pose.joints, pose.synergy)


def mirrored_mesh(obj: bytes) -> bytes:
    """An OBJ file with its x turned over, and its faces with it."""
    lines = [line.split() for line in obj.decode().splitlines()]
    for words in lines:
        if words[:1] == ["v"]:
            words[1] = repr(-float(words[1]))
        elif words[:1] == ["f"]:
            words[1:] = reversed(words[1:])
    return "\n".join(" ".join(words) for words in lines).encode()


def mirrored(scene: Scene) -> Scene:
    """The Panda and the object as a mirror in their planes x = 0 shows them.

    The fingers close along y and the shakes go along z and about x, all of which such a mirror leaves as
    they are; what it turns over are the meshes, which are not quite symmetric.
    """
    meshes = {name: mirrored_mesh(mesh) for name, mesh in scene.gripper.meshes.items()}
    target = replace(scene.object, collision=mirrored_mesh(scene.object.collision))
    return replace(with_gripper(scene, meshes=meshes), object=target)


@pytest.mark.slow
def test_the_mirrored_hand_has_the_mirrored_verdict_on_the_mirrored_box(cube):
    poses, verdicts = touching(cube, poses_of(cube, draw(2000, near=400)))
    found = outcomes(BulletShakenWorld(mirrored(cube)), [mirrored_pose(pose) for pose in poses])
    assert agreement(found, verdicts) >= AGREEMENT
