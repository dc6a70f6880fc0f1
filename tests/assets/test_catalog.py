import subprocess
import sys

import pytest

from qdgrasp_assets.catalog import build_scene
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
SOME = ("mug", "power_drill", "spatula")


def scene(**values):
    return build_scene(RunSpec(**{"gripper": "panda", "object": "mug", **values}))


def test_a_scene_is_the_same_bytes_in_a_fresh_process():
    here = [
        pack_scene(scene(object=name, protocol=protocol)).digest
        for name in SOME
        for protocol in ("paper", "released")
    ]
    fresh = subprocess.run([sys.executable, "-c", DIGEST, *SOME], capture_output=True, text=True, check=True)
    assert fresh.stdout.split() == here
    assert len(set(here)) == len(here)


def test_mass_and_friction_of_the_spec_win():
    made = scene(mass=0.5, friction=0.8).object
    assert (made.mass, made.lateral_friction) == (0.5, 0.8)
    plain = scene().object
    assert (plain.mass, plain.lateral_friction) == (0.118, 0.5)
    assert (plain.rolling_friction, plain.spinning_friction) == (0.01, 0.1)


def test_an_object_of_the_catalog_has_its_own_size():
    sentence = r"'mug' of the catalog has its own size and surface: leave --units and --mesh out"
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


def test_the_worker_needs_no_geometry_library():
    """It imports `scene` alone, which must not load what only building needs."""
    check = "import sys, qdgrasp_assets.scene; sys.exit(bool({'trimesh', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
