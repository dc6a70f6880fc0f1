"""Laws of mechanics that verdicts obey in any simulator."""

import numpy as np
import pytest
from msgspec.structs import replace
from tests.common import with_gripper
from tests.worker.genomes import draw, evaluated

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import GIVEN, Outcome

POSES = 120
AGREEMENT = 0.95
MIRROR = np.array([-1, 1, 1, 1, -1, -1, 1], dtype=np.float32)
"""Signs of a pose in the plane x = 0, for a hand whose frame is mirrored likewise."""


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
    rows = evaluated(cube, "approach", draw(1500, near=400))
    successes, brushes = rows[rows["outcome"] > Outcome.BRUSHED], rows[rows["outcome"] == Outcome.BRUSHED]
    some = np.concatenate([successes[: POSES // 2], brushes[: POSES // 2]])
    assert len(some) == POSES
    found = evaluated(mirrored(cube), GIVEN, some["base_to_object"] * MIRROR)
    assert (found["outcome"] == some["outcome"]).mean() >= AGREEMENT
