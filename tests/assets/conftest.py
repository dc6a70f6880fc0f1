"""Hands and meshes made by hand, and the reference data where it is there."""

from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh
from tests.assets import example_hands

URDF = """<robot name="claw">
<link name="mount"/>
<joint name="flange" type="fixed"><parent link="mount"/><child link="palm"/><origin xyz="0 0 0.1"/></joint>
<link name="palm"><inertial><mass value="0.5"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial>
<visual><geometry><mesh filename="palm.stl"/></geometry></visual>
<collision><geometry><mesh filename="palm.stl"/></geometry></collision></link>
<joint name="bend" type="revolute"><parent link="palm"/><child link="finger"/>
<origin xyz="0 0.02 0.05" rpy="0 0 1.5707963267948966"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1.5" effort="10" velocity="2"/></joint>
<link name="finger"><inertial><mass value="0.1"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial>
<collision><origin xyz="0.03 0 0"/><geometry><box size="0.06 0.01 0.01"/></geometry></collision></link>
</robot>"""

TOML = """urdf = "claw.urdf"
base_link = "palm"
approach_axis = [0, 0, 2]
palm_offset = 0.05
standoff = [0.0, 0.03]
finger_links = ["finger"]

[joints.bend]
open = 0.0
closed = 1.2
"""


@pytest.fixture
def claw(tmp_path: Path) -> Path:
    """The TOML of a hand with one finger, its URDF and mesh beside it."""
    trimesh.creation.box((0.06, 0.06, 0.05)).export(tmp_path / "palm.stl")
    (tmp_path / "claw.urdf").write_text(URDF, encoding="utf-8")
    toml = tmp_path / "claw.toml"
    toml.write_text(TOML, encoding="utf-8")
    return toml


Edit = Callable[[Path, str, str], None]


@pytest.fixture
def edit() -> Edit:
    """Replace text in a file that must hold it."""

    def replace(path: Path, old: str, new: str) -> None:
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")

    return replace


@pytest.fixture
def jaw_toml(tmp_path: Path) -> Path:
    """The file of the jaw, its URDF beside it."""
    (tmp_path / "jaw.urdf").write_text(example_hands.JAW_URDF, encoding="utf-8")
    toml = tmp_path / "jaw.toml"
    toml.write_text(example_hands.JAW_TOML, encoding="utf-8")
    return toml


@pytest.fixture
def jaw_urdf(jaw_toml: Path) -> Path:
    """The URDF of the jaw."""
    return jaw_toml.with_suffix(".urdf")
