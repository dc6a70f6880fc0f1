import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from qdgrasp_assets.geometry.mesh import join
from qdgrasp_assets.geometry.primitives import loft
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_assets.stand_ins import STAND_INS, stand_in
from qdgrasp_assets.ycb import read_scan

# Calli et al. 2015, table of object properties [m, kg]: sides along x, y and z, where it has them.
PUBLISHED = {
    "banana": ((None, None, None), 0.066),
    "bleach_cleanser": ((None, 0.065, 0.250), 1.131),
    "bowl": ((0.159, 0.159, 0.053), 0.147),
    "chips_can": ((0.075, 0.075, 0.250), 0.205),
    "cracker_box": ((0.060, 0.160, 0.230), 0.411),
    "rubiks_cube": ((0.057, 0.057, 0.057), 0.094),
    "tennis_ball": ((0.0647, 0.0647, 0.0647), 0.058),
    "mug": ((None, None, 0.082), 0.118),
    "power_drill": ((None, None, None), 0.895),
    "spatula": ((None, None, None), 0.0515),
}
every = pytest.mark.parametrize("name", STAND_INS)


def inside(parts, points):
    """(n,): points that lie in one of the convex parts."""
    found = np.zeros(len(points), dtype=bool)
    for part in parts:
        heights = np.einsum("fc,fc->f", part.normals, part.corners[:, 0])
        found |= (points @ part.normals.T <= heights + 1e-9).all(axis=1)
    return found


@every
def test_the_surface_is_one_closed_body_without_faces_inside(name):
    target = stand_in(name)
    mesh = trimesh.Trimesh(target.mesh.vertices, target.mesh.faces, process=False)
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert target.mesh.areas.min() > 1e-9


@every
def test_surface_and_convex_parts_enclose_the_same_space(name):
    target = stand_in(name)
    assert sum(part.volume for part in target.parts) == pytest.approx(target.mesh.volume, rel=1e-9)
    assert np.array(join(target.parts).bounds) == pytest.approx(np.array(target.mesh.bounds), abs=1e-3)


@every
def test_parts_are_convex_and_small(name):
    for part in stand_in(name).parts:
        assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_watertight
        heights = np.einsum("fc,fc->f", part.normals, part.corners[:, 0])
        assert (part.vertices @ part.normals.T <= heights + 1e-9).all()
        assert len(part.vertices) <= 92


@pytest.mark.parametrize("name", sorted(set(STAND_INS) - {"tennis_ball"}))
def test_normals_point_out_of_the_parts(name):
    target = stand_in(name)
    points, drawn = sample_surface(target.mesh, 3000, seed=0)
    normals = target.mesh.normals[drawn]
    step = 2e-5  # m
    assert not inside(target.parts, points + step * normals).any()
    assert inside(target.parts, points - step * normals).all()


def test_the_balls_normals_point_from_its_centre():
    target = stand_in("tennis_ball")
    points, drawn = sample_surface(target.mesh, 1000, seed=0)
    outward = points - target.com_in_mesh
    cosine = np.sum(outward * target.mesh.normals[drawn], axis=1) / np.linalg.norm(outward, axis=1)
    assert cosine.min() > np.cos(np.radians(6))


@every
def test_sizes_and_masses_are_the_published_ones(name):
    target = stand_in(name)
    sides, mass = PUBLISHED[name]
    turn = np.radians(0.0 if name == "bowl" else -STAND_INS[name].turn)
    upright = target.mesh.vertices[:, :2] @ [(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))]
    found = (*np.ptp(upright, axis=0), target.mesh.extents[2])
    for side, expected in zip(found, sides, strict=True):
        assert expected is None or side == pytest.approx(expected, abs=1e-9)
    assert target.mass == mass


def test_the_mug_is_80_mm_wide_below_its_rim_and_hollow():
    target = stand_in("mug")
    place = np.array(STAND_INS["mug"].place)
    around = np.linalg.norm(target.mesh.vertices[:, :2] - place[:2], axis=1)
    cup = around[np.isclose(target.mesh.vertices[:, 2], place[2] + 0.004)]
    assert cup.max() == pytest.approx(0.040)
    assert not inside(target.parts, place + np.array([(0, 0, 0.01), (0.03, 0, 0.05), (0, 0, 0.08)])).any()
    assert trimesh.Trimesh(target.mesh.vertices, target.mesh.faces, process=False).euler_number == 0
    handle_hole = place + np.array([(0.052, 0.0, 0.04), (0.055, -0.002, 0.05)])
    assert not inside(target.parts, handle_hole).any()
    assert inside(target.parts, place + np.array([(0.0663, -0.0029, 0.045)])).all()


def test_the_bowl_is_hollow_with_a_wall_that_follows_the_scanned_one():
    target = stand_in("bowl")
    place = np.array(STAND_INS["bowl"].place)
    heights = np.array([0.004, 0.02, 0.04, 0.052])
    assert not inside(target.parts, place + heights[:, None] * (0, 0, 1)).any()
    assert not inside(target.parts, place + np.array([(0.055, 0.0, 0.025), (0.0, 0.068, 0.05)])).any()
    assert inside(target.parts, place + np.array([(0.0, 0.0, 0.001), (0.078, 0.0, 0.052)])).all()


def test_a_chain_of_outlines_is_the_union_of_its_parts():
    square, point = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]), np.array([0.5, 0.5])
    flat = [
        np.column_stack([point + size * (square - point), np.full(4, z)]) for z, size in enumerate((1, 3, 1))
    ]
    surface, parts = loft(flat)
    assert trimesh.Trimesh(surface.vertices, surface.faces, process=False).is_volume
    assert len(parts) == 2
    assert surface.volume == pytest.approx(2 * (1 + 3 + 9) / 3)
    assert surface.areas.sum() == pytest.approx(2 * 1 + 8 * 2 * 2**0.5)


# Greatest difference of the extents, median and 95th percentile of the distance to the scanned surface [m].
LIKENESS = {
    "banana": (0.001, 0.001, 0.003),
    "bleach_cleanser": (0.003, 0.002, 0.003),
    "bowl": (0.003, 0.002, 0.004),
    "chips_can": (0.005, 0.002, 0.005),
    "cracker_box": (0.018, 0.005, 0.011),
    "mug": (0.003, 0.003, 0.005),
    "power_drill": (0.003, 0.002, 0.004),
    "rubiks_cube": (0.002, 0.002, 0.003),
    "spatula": (0.002, 0.001, 0.003),
    "tennis_ball": (0.003, 0.002, 0.003),
}


@every
def test_a_stand_in_lies_where_its_scan_lies(asset_path, name):
    own, scan = stand_in(name), read_scan(f"ycb_{name}", "paper")
    extents, median, far = LIKENESS[name]
    assert own.com_in_mesh == pytest.approx(scan.com_in_mesh, abs=1e-9)
    assert own.mass == scan.mass
    assert own.centred_mesh.extents == pytest.approx(scan.centred_mesh.extents, abs=extents)
    here, there = (
        sample_surface(own.centred_mesh, 3000, 0)[0],
        sample_surface(scan.centred_mesh, 20_000, 0)[0],
    )
    distances = cKDTree(there).query(here)[0]
    assert np.median(distances) < median
    assert np.percentile(distances, 95) < far
