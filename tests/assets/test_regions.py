"""Regions of an object: each way to say where, and those that cannot be used."""

import pytest
import trimesh

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.regions import allowed_points, regions_at
from qdgrasp_assets.scene import pack_scene, unpack_scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import run_spec

HANDLE = "handle", "box:0.027,-1,-1,1,1,1", "ball:1.027,0.017,0.04,1.0005", "handle.stl"


def scene_of(**regions):
    return build_scene(run_spec({"gripper": "panda", "object": "mug"} | regions))


@pytest.mark.parametrize("region", HANDLE)
@pytest.mark.parametrize("key", ["on", "avoid"])
def test_surface_points_are_on_the_part_that_is_said(tmp_path, region, key):
    trimesh.creation.box(bounds=[(0.027, -0.1, -0.1), (0.1, 0.1, 0.1)]).export(tmp_path / "handle.stl")
    scene = scene_of(**{key: [str(tmp_path / region) if region.endswith("stl") else region]})
    x = scene.surface_points[:, 0] + scene.object.com_in_mesh[0]
    assert 0.026 < x.min() < x.max() if key == "on" else x.min() < x.max() < 0.035
    assert unpack_scene(pack_scene(scene).payload).regions == scene.regions
    points, allowed = allowed_points(scene)
    known = regions_at(scene, points + scene.object.com_in_mesh)
    assert [bool(name) for name in known] == (allowed if key == "on" else ~allowed).tolist()


@pytest.mark.parametrize("on", ["tap", "box:0,0,0", "above:20", "absent.ply"])
def test_a_region_that_cannot_be_used_is_refused(on):
    with pytest.raises(InputError, match=r"Known: handle, rim|box:x0,y0|goes from|No mesh file"):
        scene_of(on=[on])
