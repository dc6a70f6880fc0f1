import json

import numpy as np
import pytest

from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_assets.ycb import SCAN_NAMES, read_scan, scan_source
from qdgrasp_protocol.errors import AssetError


@pytest.mark.parametrize("name", SCAN_NAMES)
def test_a_scans_normals_point_outward(asset_path, name):
    import trimesh

    mesh = read_scan(name, "paper").mesh
    points, drawn = sample_surface(mesh, 1000, seed=0)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    step = 5e-5  # m
    assert mesh.volume > 0
    assert solid.contains(points + step * mesh.normals[drawn]).mean() < 0.02
    assert solid.contains(points - step * mesh.normals[drawn]).mean() > 0.98


@pytest.mark.parametrize("name", SCAN_NAMES)
def test_a_scans_collision_parts_cover_it(asset_path, name):
    target = read_scan(name, "paper")
    low = np.min([part.bounds[0] for part in target.parts], axis=0)
    high = np.max([part.bounds[1] for part in target.parts], axis=0)
    assert low == pytest.approx(target.mesh.bounds[0], abs=4e-3)
    assert high == pytest.approx(target.mesh.bounds[1], abs=4e-3)
    assert all(part.volume > 0 for part in target.parts)


def test_the_centre_of_mass_is_the_tabled_inertial_origin(asset_path):
    table = json.loads((asset_path / "objects/objects.json").read_text())
    for name in SCAN_NAMES:
        expected = table[name.removeprefix("ycb_")]["inertial_origin_xyz"]
        assert read_scan(name, "paper").com_in_mesh == pytest.approx(expected)


def test_a_scan_that_is_not_there_says_what_it_is_and_where_it_was_looked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("QDGRASP_ASSET_PATH", f"{tmp_path}/a:{tmp_path}/b")
    assert scan_source("ycb_mug") == "absent"
    with pytest.raises(AssetError, match=rf"'ycb_mug' is a scan .*QDGRASP_ASSET_PATH is '{tmp_path}/a:"):
        read_scan("ycb_mug", "paper")
