"""Settled poses and contacts of successes: they belong to the joints after closing."""

from math import dist

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.worker.genomes import draw, evaluated

from qdgrasp_assets.geometry.rotation import rotate
from qdgrasp_assets.geometry.voxels import Hull
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_protocol.rows import CONTACT_VALUES, Outcome
from qdgrasp_worker.evaluator import spread_contacts
from qdgrasp_worker.object_geometry import ObjectSolid
from qdgrasp_worker.world import GraspContact

N = 60


@pytest.fixture(scope="module")
def rows(recorded_cube):
    return evaluated(recorded_cube, "approach", draw(N, near=40))


@pytest.fixture(scope="module")
def recorded_cube(cube):
    """The Panda over the cube, with room for contacts as the catalog says."""
    assert cube.contact_slots == 8
    return cube


def outside(hulls: list[Hull], point: NDArray[np.float64]) -> float:
    """How far a point (3,) is outside the nearest hull at least [m]; negative inside."""
    return min(float((hull.planes @ np.append(point, 1.0)).max()) for hull in hulls)


def test_contacts_lie_on_the_object_and_on_the_link_that_they_name(recorded_cube, rows):
    hand, solid = hand_geometry(recorded_cube.gripper), ObjectSolid(recorded_cube)
    successes = rows[rows["outcome"] >= Outcome.DROPPED]
    seen = set()
    for row in successes:
        frames = hand.frames(row["joints"][None].astype(np.float64))
        position, quaternion = row["settled"][:3].astype(np.float64), row["settled"][3:].astype(np.float64)
        values = row["contact_points"].reshape(-1, CONTACT_VALUES).astype(np.float64)
        for link, (*point, nx, ny, nz, force) in zip(row["contact_links"], values, strict=True):
            if not link:
                continue
            name = recorded_cube.gripper.links[link - 1]
            seen.add(name)
            assert abs(outside(solid.hulls, np.array(point))) < 1.5e-3
            assert np.linalg.norm([nx, ny, nz]) == pytest.approx(1.0, abs=2e-3)
            deeper = np.array(point) + 1e-3 * np.array([nx, ny, nz])
            assert outside(solid.hulls, deeper) < outside(solid.hulls, np.array(point)) - 5e-4
            assert force >= 0
            back = quaternion * np.array([-1.0, -1.0, -1.0, 1.0])
            frame = frames[name][0]
            in_link = frame[:3, :3].T @ (rotate(back, np.array(point) - position) - frame[:3, 3])
            assert outside(hand.hulls[name], in_link) < 2e-3
    assert seen == set(recorded_cube.gripper.finger_links)
    assert (successes["contact_points"].reshape(len(successes), -1, CONTACT_VALUES)[..., 6].sum(1) > 1).any()


def test_of_many_contacts_those_far_from_each_other_are_kept_with_all_of_the_force():
    random = np.random.default_rng(1)
    contacts = [
        GraspContact(1 + i % 3, random.uniform(-0.05, 0.05, 3).tolist(), [0.0, 0.0, 1.0], float(i))
        for i in range(20)
    ]
    kept = spread_contacts(contacts, 6)
    assert len(kept) == 6
    assert sum(contact.force for contact in kept) == sum(range(20))
    assert kept[0].point == contacts[19].point
    assert spread_contacts(contacts[:6], 6) == contacts[:6]
    nearest = [min(dist(a.point, b.point) for b in kept if b is not a) for a in kept]
    assert min(nearest) > 0.03
