"""A jaw has its whole room in `physical`: only bodies that meet overlap, in either engine."""

import numpy as np
import pytest
import trimesh
from tests.worker.genomes import evaluated, outcomes

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec

APPROACH_DOWN = (0.11, 1.0, 0.0, 0.0, 0.0)
"""z [m] and quaternion of a hand above the object whose fingers close along y."""
FREE, MET = 2e-4, -5e-4
"""Gap of a side from which on there is no overlap, and up to which there is one [m]."""


def room(scene: Scene) -> float:
    """The distance of each finger from the middle of the open hand [m]."""
    hand = hand_geometry(scene.gripper)
    frames = hand.frames(np.array([[joint.opened for joint in scene.gripper.joints]]))
    placed = [hull.moved(frames[link][0]) for link in scene.gripper.finger_links for hull in hand.hulls[link]]
    return min(float(np.abs(hull.surface.vertices[:, 1]).min()) for hull in placed)


@pytest.mark.parametrize("diameter", [0.077, 0.0785, 0.0793])
def test_a_cylinder_that_fits_is_held_and_one_that_a_finger_meets_overlaps(diameter, tmp_path):
    file, verdicts = tmp_path / "cylinder.stl", []
    trimesh.creation.cylinder(diameter / 2, 0.06, sections=64).export(file)
    for engine in (None, "mujoco"):
        spec = RunSpec(
            gripper="panda", object=str(file), protocol="physical", engine=engine, scale=1.0, mass=0.1
        )
        scene = build_scene(spec)
        corners = np.concatenate([part.vertices for part in parse_parts(scene.object.collision.decode())])
        gap = room(scene) - float(corners[:, 1].max())
        shifts = np.outer((-1, 1), (0.0, gap - 1.1 * FREE, gap - 1.1 * MET)).ravel()
        poses = np.array([(0.0, shift, *APPROACH_DOWN) for shift in shifts], dtype=np.float32)
        found = outcomes(evaluated(scene, "given", poses))
        left = gap - np.abs(shifts)
        assert {each for each, free in zip(found, left >= FREE, strict=True) if free} == {Outcome.HELD}
        assert {each for each, met in zip(found, left <= MET, strict=True) if met} == {Outcome.OVERLAP}
        verdicts.append(found)
    assert verdicts[0] == verdicts[1]
