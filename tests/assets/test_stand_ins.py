import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from qdgrasp_assets.geometry.mesh import join
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_assets.stand_ins import STAND_INS, stand_in
from qdgrasp_assets.ycb import read_scan

# Calli et al. 2015, table of object properties [m, kg]: sides along x, y and z, where it has them.
every = pytest.mark.parametrize("name", STAND_INS)


@every
def test_surface_and_convex_parts_enclose_the_same_space_in_one_closed_body(name):
    target = stand_in(name)
    mesh = trimesh.Trimesh(target.mesh.vertices, target.mesh.faces, process=False)
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert target.mesh.areas.min() > 1e-9
    assert sum(part.volume for part in target.parts) == pytest.approx(target.mesh.volume, rel=1e-9)
    assert np.array(join(target.parts).bounds) == pytest.approx(np.array(target.mesh.bounds), abs=1e-3)


@every
def test_a_stand_in_lies_where_its_scan_lies(asset_path, name):
    own, scan = stand_in(name), read_scan(f"ycb_{name}", "paper")
    assert own.com_in_mesh == pytest.approx(scan.com_in_mesh, abs=1e-9)
    assert own.mass == scan.mass
    assert own.centred_mesh.extents == pytest.approx(
        scan.centred_mesh.extents, abs=0.018 if name == "cracker_box" else 0.005
    )
    here, there = (
        sample_surface(own.centred_mesh, 3000, 0)[0],
        sample_surface(scan.centred_mesh, 20_000, 0)[0],
    )
    distances = cKDTree(there).query(here)[0]
    assert np.median(distances) < 0.005
    assert np.percentile(distances, 95) < 0.011
