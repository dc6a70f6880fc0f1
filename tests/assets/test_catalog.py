import subprocess
import sys

import numpy as np
import pytest
import trimesh
from msgspec.structs import replace

from qdgrasp_assets import catalog
from qdgrasp_assets.catalog import (
    build_scene,
    carried_hand,
    every_gripper,
    every_object,
    find_gripper,
    gripper_names,
    object_names,
)
from qdgrasp_assets.scene import pack_scene
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_protocol.errors import AssetError, UnknownName
from qdgrasp_protocol.spec import RunSpec

DIGEST = """
import sys
from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import pack_scene
from qdgrasp_protocol.spec import RunSpec
for name in sys.argv[1:]:
    for protocol in ("paper", "released"):
        print(pack_scene(build_scene(RunSpec(gripper="panda", object=name, protocol=protocol))).digest)
"""


def scene(**values):
    return build_scene(RunSpec(**{"gripper": "panda", "object": "mug", **values}))


def test_a_scene_is_the_same_bytes_in_a_fresh_process():
    here = [
        pack_scene(scene(object=name, protocol=protocol)).digest
        for name in STAND_INS
        for protocol in ("paper", "released")
    ]
    fresh = subprocess.run(
        [sys.executable, "-c", DIGEST, *STAND_INS], capture_output=True, text=True, check=True
    )
    assert fresh.stdout.split() == here
    assert len(set(here)) == len(here)


def test_mass_and_friction_of_the_spec_win():
    made = scene(mass=0.5, friction=0.8).object
    assert (made.mass, made.lateral_friction) == (0.5, 0.8)
    plain = scene().object
    assert (plain.mass, plain.lateral_friction) == (0.118, 0.5)
    assert (plain.rolling_friction, plain.spinning_friction) == (0.01, 0.1)


def test_a_mesh_file_is_an_object_around_its_centre_of_mass(tmp_path):
    path = tmp_path / "bar.stl"
    trimesh.creation.box((0.02, 0.02, 0.1)).apply_translation((0.3, 0.1, 0.05)).export(path)
    for protocol in ("paper", "released"):
        made = scene(object=str(path), mass=0.3, protocol=protocol).object
        assert (made.name, made.source, made.collision_source) == ("bar", "bar.stl", "own hull")
        assert made.mass == 0.3
        assert made.com_in_mesh == pytest.approx((0.3, 0.1, 0.05), abs=1e-6)
        vertices = np.frombuffer(made.mesh_vertices, "<f4").reshape(-1, 3)
        assert np.abs(vertices).max(axis=0) == pytest.approx((0.01, 0.01, 0.05), abs=1e-6)


def test_a_scale_is_that_of_the_mesh_file_and_told_by_the_scene(tmp_path):
    path = tmp_path / "bar.stl"
    trimesh.creation.box((20, 20, 100)).apply_translation((300, 100, 50)).export(path)
    made = scene(object=str(path), mass=0.3, scale=0.001)
    assert made.object.source == "bar.stl (scale 0.001)"
    assert made.object.com_in_mesh == pytest.approx((0.3, 0.1, 0.05), abs=1e-6)
    assert made.object_high == pytest.approx((0.01, 0.01, 0.05), abs=1e-6)
    same = tmp_path / "metres" / "bar.stl"
    same.parent.mkdir()
    trimesh.creation.box((0.02, 0.02, 0.1)).export(same)
    assert scene(object=str(same), mass=0.3).object.source == "bar.stl"


def test_an_object_of_the_catalog_has_its_own_size():
    sentence = r"'mug' of the catalog has its own size: leave --units out"
    with pytest.raises(AssetError, match=sentence):
        scene(object="mug", scale=0.5)


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(UnknownName, match=r"Unknown gripper 'pandda'\. Did you mean 'panda'") as gripper:
        scene(gripper="pandda")
    with pytest.raises(UnknownName, match=r"Unknown object 'mugg'\. Did you mean 'mug'") as thing:
        scene(object="mugg")
    with pytest.raises(UnknownName, match="Unknown object 'ycb_teapot'"):
        scene(object="ycb_teapot")
    assert "TOML file" in str(gripper.value)
    assert "mesh file" in str(thing.value)
    assert all(name in str(thing.value) for name in STAND_INS)


def test_the_catalog_lists_what_is_there(monkeypatch, tmp_path):
    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(tmp_path))
    assert "panda" in gripper_names()
    assert not any(name.startswith("ref_") for name in gripper_names())
    assert object_names() == tuple(STAND_INS)
    here = [entry for entry in (*every_gripper(), *every_object()) if entry.is_there]
    assert all(entry.source == "built in" and entry.licence for entry in here)


def test_a_reference_scene_is_the_same_bytes_again(asset_path):
    spec = {"gripper": "ref_panda_2f", "object": "ycb_power_drill"}
    assert pack_scene(scene(**spec)).digest == pack_scene(scene(**spec)).digest


def counted_reads(monkeypatch) -> list[str]:
    """The names of the grippers that are read from now on."""
    read = []

    def find(name):
        read.append(name)
        return find_gripper(name)

    monkeypatch.setattr(catalog, "find_gripper", find)
    monkeypatch.setattr(catalog, "_hands", {})
    return read


def test_a_hand_is_read_once_for_each_protocol_until_one_of_its_files_changes(monkeypatch, claw, edit):
    monkeypatch.setattr(catalog, "SETTLED", 0)
    read, spec = counted_reads(monkeypatch), RunSpec(gripper=str(claw), object="mug")
    first = carried_hand(spec)
    assert carried_hand(spec) is first
    assert carried_hand(replace(spec, protocol="released")) != first
    assert carried_hand(replace(spec, protocol="robust")) is first
    assert len(read) == 2
    edit(claw, "palm_offset = 0.05", "palm_offset = 0.06")
    assert carried_hand(spec).palm_offset == 0.06
    edit(claw.with_suffix(".urdf"), 'value="0.1"', 'value="0.2"')
    assert 'value="0.2"' in carried_hand(spec).urdf
    mesh = claw.parent / "palm.stl"
    mesh.write_bytes(mesh.read_bytes()[:-2] + b"\1\0")
    assert carried_hand(spec).meshes["0_palm.stl"].endswith(b"\1\0")
    assert len(read) == 5
    mesh.unlink()
    with pytest.raises(AssetError, match=r"palm\.stl"):
        carried_hand(spec)


def test_the_worker_needs_no_geometry_library():
    """It imports `scene` alone, which must not load what only building needs."""
    check = (
        "import sys, qdgrasp_assets.scene; sys.exit(bool({'trimesh', 'scipy', 'coacd'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
