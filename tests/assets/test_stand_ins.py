import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from qdgrasp_assets.mesh import join
from qdgrasp_assets.objects.stand_ins import STAND_INS, stand_in
from qdgrasp_assets.surface import sample
from qdgrasp_assets.ycb import read_scan

# Calli et al. 2015, table of object properties [m, kg]; box sides, cube sides, diameter, diameter and height.
PUBLISHED = {
    "cracker_box": ((0.060, 0.160, 0.230), 0.411),
    "rubiks_cube": ((0.057, 0.057, 0.057), 0.094),
    "tennis_ball": ((0.0647, 0.0647, 0.0647), 0.058),
    "mug": ((None, None, 0.082), 0.118),
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
    for low, high in [(join(target.parts).bounds, target.mesh.bounds)]:
        assert np.array(low) == pytest.approx(np.array(high), abs=1e-3)


@every
def test_parts_are_convex_and_small(name):
    for part in stand_in(name).parts:
        assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_watertight
        heights = np.einsum("fc,fc->f", part.normals, part.corners[:, 0])
        assert (part.vertices @ part.normals.T <= heights + 1e-9).all()
        assert len(part.vertices) <= 92


@pytest.mark.parametrize("name", ["cracker_box", "rubiks_cube", "mug"])
def test_normals_point_out_of_the_parts(name):
    target = stand_in(name)
    points, drawn = sample(target.mesh, 3000, seed=0)
    normals = target.mesh.normals[drawn]
    step = 2e-5  # m
    assert not inside(target.parts, points + step * normals).any()
    assert inside(target.parts, points - step * normals).all()


def test_the_balls_normals_point_from_its_centre():
    target = stand_in("tennis_ball")
    points, drawn = sample(target.mesh, 1000, seed=0)
    outward = points - target.com_in_mesh
    cosine = np.sum(outward * target.mesh.normals[drawn], axis=1) / np.linalg.norm(outward, axis=1)
    assert cosine.min() > np.cos(np.radians(6))


@every
def test_sizes_and_masses_are_the_published_ones(name):
    target = stand_in(name)
    sides, mass = PUBLISHED[name]
    turn = np.radians(-STAND_INS[name].turn)
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


# Greatest difference of the extents, and the median distance between the surfaces [m].
LIKENESS = {
    "cracker_box": (0.018, 0.005),
    "rubiks_cube": (0.002, 0.002),
    "tennis_ball": (0.003, 0.002),
    "mug": (0.003, 0.003),
}


@every
def test_a_stand_in_lies_where_its_scan_lies(asset_path, name):
    own, scan = stand_in(name), read_scan(f"ycb_{name}", "paper")
    extents, distance = LIKENESS[name]
    assert own.com_in_mesh == pytest.approx(scan.com_in_mesh, abs=1e-9)
    assert own.mass == scan.mass
    assert own.centred_mesh.extents == pytest.approx(scan.centred_mesh.extents, abs=extents)
    here, there = sample(own.centred_mesh, 3000, 0)[0], sample(scan.centred_mesh, 20_000, 0)[0]
    assert np.median(cKDTree(there).query(here)[0]) < distance
