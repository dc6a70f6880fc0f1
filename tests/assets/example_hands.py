"""Example hands as URDFs and gripper files: a jaw, one with hollow fingers, and a linkage.

The jaw is made of boxes and has two fingers that slide, the second mimicking the first. The arched jaw has
hollow fingers, of which the simulator would make solid ones, and a palm without a mass. The fingers of the
linkage stay parallel: one joint leads, three mimic it, as those of Robotiq do.
"""

from pathlib import Path

import trimesh

INERTIA = '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>'

JAW_URDF = f"""<robot name="jaw">
<link name="palm"><inertial><mass value="0.5"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.02"/><geometry><box size="0.06 0.14 0.04"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="palm"/><child link="left"/>
<origin xyz="0 0.045 0.041"/><axis xyz="0 1 0"/>
<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/></joint>
<link name="left"><inertial><mass value="0.1"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision></link>
<joint name="other" type="prismatic"><parent link="palm"/><child link="right"/>
<origin xyz="0 -0.045 0.041"/><axis xyz="0 -1 0"/>
<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/><mimic joint="slide"/></joint>
<link name="right"><inertial><mass value="0.1"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision></link>
</robot>"""

JAW_TOML = """urdf = "jaw.urdf"
licence = "CC0"
base_link = "palm"
approach_axis = [0, 0, 1]
palm_offset = 0.04
standoff = [0.0, 0.06]
finger_links = ["left", "right"]

[jaw]
axis = [0, 1, 0]
opening = 0.08

[joints.slide]
open = 0.0
closed = -0.04

[joints.other]
open = 0.0
closed = -0.04
"""


BOX = '<box size="0.02 0.01 0.06"/>'
"""The shape of a finger of the jaw."""
LEGS_AND_TOP = [
    [(-0.010, -0.005, -0.030), (-0.005, 0.005, 0.030)],
    [(0.005, -0.005, -0.030), (0.010, 0.005, 0.030)],
    [(-0.010, -0.005, 0.030), (0.010, 0.005, 0.035)],
]


def write_arch(path: Path) -> None:
    """Write the mesh of a finger: an arch as large as the finger of the jaw."""
    trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in LEGS_AND_TOP]).export(path)


LINKAGE_LIMIT = '<limit lower="{}" upper="{}" effort="20" velocity="2"/>'


def linkage_link(name: str, mass: float, place: str, size: str) -> str:
    """A link that is a box."""
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/>{INERTIA}</inertial>'
        f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision></link>'
    )


def linkage_joint(name: str, parent: str, child: str, place: str, sense: int, mimics: int = 0) -> str:
    """A joint about x that turns by 0 to 0.7 rad, or mimics the leader."""
    limit = LINKAGE_LIMIT.format(-0.7, 0) if sense < 0 else LINKAGE_LIMIT.format(0, 0.7)
    mimic = f'<mimic joint="knuckle" multiplier="{mimics}"/>' if mimics else ""
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="1 0 0"/>{limit}{mimic}</joint>'
    )


LINKAGE_URDF = "\n".join(
    [
        '<robot name="linkage">',
        linkage_link("palm", 0.6, "0 0 0.03", "0.06 0.12 0.06"),
        linkage_joint("knuckle", "palm", "left_knuckle", "0 0.055 0.06", 1),
        linkage_link("left_knuckle", 0.05, "0 0 0.025", "0.02 0.008 0.05"),
        linkage_joint("left_pad", "left_knuckle", "left_finger", "0 0 0.05", -1, -1),
        linkage_link("left_finger", 0.05, "0 -0.008 0.03", "0.022 0.012 0.06"),
        linkage_joint("other", "palm", "right_knuckle", "0 -0.055 0.06", -1, -1),
        linkage_link("right_knuckle", 0.05, "0 0 0.025", "0.02 0.008 0.05"),
        linkage_joint("right_pad", "right_knuckle", "right_finger", "0 0 0.05", 1, 1),
        linkage_link("right_finger", 0.05, "0 0.008 0.03", "0.022 0.012 0.06"),
        "</robot>",
    ]
)
