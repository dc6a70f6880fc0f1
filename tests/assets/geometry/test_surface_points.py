import numpy as np
import pytest

from qdgrasp_assets.geometry.mesh import box
from qdgrasp_assets.geometry.surface_points import paper_surface, released_surface, sample_surface
from qdgrasp_assets.stand_ins import stand_in
from qdgrasp_assets.ycb import SCAN_NAMES, read_scan

# Measured on the authors' code: low and high corner of the finder's box as used, number of points.
RELEASED = {
    "rubiks_cube": ((-0.0583, -0.0429, -0.0046), (0.0259, 0.0418, 0.0616), 1071),
    "mug": ((-0.0716, -0.0335, -0.0048), (0.0539, 0.0683, 0.0851), 1452),
    "power_drill": ((-0.0749, -0.0434, -0.0101), (0.0930, 0.0858, 0.1903), 2445),
    "banana": ((-0.0655, -0.0868, -0.0104), (0.1031, 0.0463, 0.0455), 1636),
    "bowl": ((-0.0998, -0.1285, -0.0048), (0.0702, 0.0409, 0.0589), 1912),
    "tennis_ball": ((-0.0295, -0.0821, -0.0038), (0.0460, -0.0065, 0.0707), 1215),
    "spatula": ((-0.1837, -0.1635, -0.0049), (0.1298, -0.0307, 0.0366), 2822),
    "bleach_cleanser": ((-0.0774, -0.0266, -0.0050), (0.0343, 0.0498, 0.2546), 2742),
    "cracker_box": ((-0.0534, -0.1008, -0.0079), (0.0279, 0.0722, 0.2148), 2553),
    "chips_can": ((-0.0509, -0.0316, -0.0041), (0.0372, 0.0554, 0.2504), 2660),
}


def test_points_are_uniform_by_area():
    block = box((0.1, 0.2, 0.4))
    n = 20_000
    _, drawn = sample_surface(block, n, seed=0)
    share = block.areas / block.areas.sum()
    expected, found = share * n, np.bincount(drawn, minlength=len(share))
    assert (np.abs(found - expected) < 5 * np.sqrt(expected)).all()


def test_paper_has_2000_points_for_each_200_mm_of_diagonal_and_the_objects_own_box():
    target = stand_in("cracker_box")
    mesh = target.centred_mesh
    surface = paper_surface(mesh, target.centred_parts, target.com_in_mesh, seed=0)
    assert len(surface.surface_points) == pytest.approx(10_000 * np.linalg.norm(mesh.extents), abs=1)
    assert surface.finder_low == pytest.approx(mesh.bounds[0])
    assert surface.finder_high == pytest.approx(mesh.bounds[1])
    assert (surface.surface_points >= np.array(surface.finder_low) - 1e-8).all()
    assert (surface.surface_points <= np.array(surface.finder_high) + 1e-8).all()


@pytest.mark.parametrize("scan", SCAN_NAMES)
def test_released_reproduces_the_tabled_boxes_and_numbers_of_points(asset_path, scan):
    target = read_scan(scan, "released")
    surface = released_surface(target.centred_mesh, target.centred_parts, target.com_in_mesh, seed=0)
    low, high, points = RELEASED[scan.removeprefix("ycb_")]
    assert surface.finder_low == pytest.approx(low, abs=1e-4)
    assert surface.finder_high == pytest.approx(high, abs=1e-4)
    assert len(surface.surface_points) == points
    assert np.linalg.norm(surface.surface_normals, axis=1) == pytest.approx(np.ones(points), abs=1e-6)
