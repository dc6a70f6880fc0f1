"""The built-in hands: alone, and beside the reference hands of the paper's experiment."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.grippers.collision_shapes import shapes
from qdgrasp_assets.grippers.gripper import Gripper
from qdgrasp_assets.grippers.urdf import Urdf

REFERENCES = {
    "allegro": "ref_allegro",
    "barrett": "ref_bh280",
    "panda": "ref_panda_2f",
    "robotiq_2f": "ref_robotiq_2f",
    "shadow": "ref_shadow",
}
POSTURES = 200
SAMPLES = 6000
"""Points on the surface of a link."""
ALL_SYNERGIES = ["thumb_index", "thumb_mid", "thumb_index_mid", "all"]


@dataclass(frozen=True)
class Hand:
    """A gripper of the catalog, and its URDF from the base link on."""

    gripper: Gripper
    robot: Urdf

    @property
    def moving(self):
        return [joint for joint in self.robot.joints if joint.moves]


@dataclass(frozen=True)
class Pair:
    """A built-in hand and the reference."""

    own: Hand
    reference: Hand

    def postures(self, count):
        """Random joint positions within the limits; merged joints stand as in the open hand."""
        random = np.random.default_rng(0)
        merged = {name: table.open for name, table in self.reference.gripper.file.joints.items()}
        for _ in range(count):
            yield {**merged, **{j.name: random.uniform(j.lower, j.upper) for j in self.own.moving}}

    def owner(self, link):
        """The built-in hand's link that a link of the reference is part of."""
        parents = {joint.child: joint.parent for joint in self.reference.robot.joints}
        while link not in self.own.robot.links:
            link = parents.get(link, self.own.robot.root)
        return link


def find_hand(name):
    gripper = find_gripper(name)
    return Hand(gripper, gripper.robot.subtree(gripper.file.base_link))


@pytest.fixture(params=REFERENCES)
def own(request):
    return find_hand(request.param)


@pytest.fixture(params=REFERENCES)
def pair(request, asset_path):
    return Pair(find_hand(request.param), find_hand(REFERENCES[request.param]))


@pytest.mark.parametrize("name", REFERENCES)
def test_a_hand_needs_no_files_but_the_projects_own(name, monkeypatch):
    monkeypatch.delenv("QDGRASP_ASSET_PATH", raising=False)
    for protocol in ("paper", "released"):
        assert find_gripper(name).on_carrier(protocol).source == "built in"


@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_a_hand_with_a_thumb_has_the_synergies_of_the_paper(name):
    own = find_gripper(name)
    assert [synergy.name for synergy in own.file.synergies] == ALL_SYNERGIES
    closing = {joint for joint, table in own.file.joints.items() if table.closed is not None}
    assert set(own.file.synergies[-1].joints) == closing


def test_a_hand_grasps_as_the_reference_is_told_to(pair):
    own, reference = (hand.gripper.on_carrier("paper") for hand in (pair.own, pair.reference))
    assert own.approach_axis == reference.approach_axis
    assert (own.palm_offset, own.standoff) == (reference.palm_offset, reference.standoff)
    assert own.synergies == reference.synergies
    assert own.free_joints == reference.free_joints
    told = {joint.name: joint for joint in reference.joints}
    for joint in own.joints:
        assert (joint.opened, joint.closed) == (told[joint.name].opened, told[joint.name].closed)
        assert joint.velocity == told[joint.name].velocity
    assert {name for name, joint in told.items() if joint.driven} <= {joint.name for joint in own.joints}


def test_links_stand_where_those_of_the_reference_do_in_any_posture(pair):
    probes = np.vstack([np.zeros(3), 0.05 * np.eye(3)])  # the frame, and points beyond any fingertip
    for posture in pair.postures(POSTURES):
        own, reference = (hand.robot.forward(posture) for hand in (pair.own, pair.reference))
        for link in pair.own.gripper.file.finger_links:
            np.testing.assert_allclose(placed(probes, own[link]), placed(probes, reference[link]), atol=1e-3)


def test_the_surface_of_every_link_is_near_that_of_the_reference(pair):
    (posture,) = pair.postures(1)
    own = surfaces(pair.own, posture, lambda link: link)
    reference = surfaces(pair.reference, posture, pair.owner)
    assert own.keys() == reference.keys()
    for link, points in own.items():
        assert distance(points, reference[link]) <= 0.010, link
        assert distance(reference[link], points) <= 0.010, link


def placed(points, frame):
    return points @ frame[:3, :3].T + frame[:3, 3]


def distance(points, others):
    """Distance within which 95 of 100 points have a nearest other one [m]."""
    return np.percentile(KDTree(others).query(points)[0], 95)


def surfaces(hand, posture, owner):
    """Points on the surface of each link (n, 3) [m], base frame, of the hull of each shape."""
    element, files = hand.robot.bundled()
    frames = hand.robot.forward(posture)
    found = {}
    for shape in shapes(replace(hand.robot, element=element), files):
        hull = trimesh.convex.convex_hull(placed(shape.vertices, frames[shape.link]))
        found.setdefault(owner(shape.link), []).append(hull)
    return {link: np.concatenate(list(outer(parts))) for link, parts in found.items()}


def outer(parts):
    """Points on each part that are in no other one."""
    area = sum(part.area for part in parts)
    for part in parts:
        count = max(100, int(SAMPLES * part.area / area))
        points, _ = trimesh.sample.sample_surface(part, count, seed=0)
        others = [other for other in parts if other is not part]
        yield points[~np.any([inside(points, other) for other in others], axis=0)] if others else points


def inside(points, hull):
    """Mask of points (n, 3) in a convex hull, deeper than 0.01 mm."""
    normals = hull.face_normals
    offsets = (hull.triangles[:, 0] * normals).sum(axis=1)
    return (points @ normals.T - offsets).max(axis=1) < -1e-5
