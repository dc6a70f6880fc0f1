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


@pytest.fixture
def bar(tmp_path):
    """A folder of files of a bar of two blocks, each .02 m high, of which the upper one has names."""
    blocks = [trimesh.creation.box(bounds=[(-0.01, -0.01, z), (0.01, 0.01, z + 0.02)]) for z in (-0.02, 0)]
    whole = trimesh.util.concatenate(blocks)
    corners, faces = ([f"{key} {a} {b} {c}" for a, b, c in rows]
                      for key, rows in (("v", whole.vertices), ("f", whole.faces + 1)))  # fmt: skip
    names, seam = ("g tip tops", "usemtl red paint"), ("g seam", "f 9 9 10")  # without area
    lines = *corners, "g base", *faces[:12], *names, *faces[12:], *seam
    (tmp_path / "bar.obj").write_text("\n".join(lines))
    whole.visual.face_colors = [(128, 128, 128, 255)] * 12 + [(255, 0, 0, 255)] * 12
    whole.export(tmp_path / "bar.ply")
    upward = trimesh.transformations.translation_matrix((0, 0, 0.02))
    scene = trimesh.Scene({"base": blocks[0], "dots": trimesh.PointCloud(whole.vertices)})
    scene.add_geometry(blocks[0], node_name="tip", transform=upward)
    scene.export(tmp_path / "bar.glb")
    (tmp_path / "bar.toml").write_text('[regions]\nend = "tip"\n')
    whole.apply_scale(1000).export(tmp_path / "large.stl")
    return tmp_path


OWN = "bar.obj:tip", "bar.obj:red paint", "bar.obj:seam", "bar.glb:end", "bar.ply:#ff0000"


@pytest.mark.parametrize("part", OWN)
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_region_is_a_part_that_the_file_of_the_object_names(bar, part, scale):
    file, region = part.split(":")
    scene = scene_of(object=str(bar / file), mass=0.1, scale=scale, on=[region])
    heights = scene.surface_points[:, 2] + scene.object.com_in_mesh[2]
    assert -0.0011 < heights.min() < 0.01 * scale < heights.max()


@pytest.mark.parametrize("on", ["tap", "box:0,0,0", "above:20", "absent.ply", "large.stl"])
def test_a_region_that_cannot_be_used_is_refused(bar, monkeypatch, on):
    monkeypatch.chdir(bar)
    sentence = r"Known: base, end, red paint, seam, tip, .*|box:x0,y0|goes from|No mesh file|is 40 m"
    with pytest.raises(InputError, match=sentence) as refused:
        scene_of(object="bar.obj", mass=0.1, on=[on])
    assert "\n" not in str(refused.value)
