"""Scenes made by hand: a jaw of three boxes and any object that a test needs."""

from collections.abc import Callable

import numpy as np
import trimesh
from msgspec.structs import replace

from qdgrasp_assets.geometry import mesh
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_assets.scene import CarrierJoint, Joint, Region, Scene, SceneGripper, SceneObject

SceneMaker = Callable[..., Scene]

JAW = """<robot name="jaw">
<link name="palm"><collision><origin xyz="0 0 0.03"/><geometry><box size="0.04 0.2 0.06"/></geometry></collision></link>
<joint name="left" type="prismatic"><parent link="palm"/><child link="left_finger"/>
<origin xyz="0 0 0.06"/><axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="100" velocity="1"/></joint>
<link name="left_finger"><collision><origin xyz="0 0.01 0.025"/><geometry><box size="0.02 0.02 0.05"/></geometry></collision></link>
<joint name="right" type="prismatic"><parent link="palm"/><child link="right_finger"/>
<origin xyz="0 0 0.06" rpy="0 0 3.141592653589793"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" effort="100" velocity="1"/></joint>
<link name="right_finger"><collision><origin xyz="0 0.01 0.025"/><geometry><box size="0.02 0.02 0.05"/></geometry></collision></link>
</robot>"""  # noqa: E501


def jaw(name: str) -> SceneGripper:
    joints = [
        Joint(name=side, opened=0.04, closed=0.0, effort=100.0, velocity=1.0) for side in ("left", "right")
    ]
    return SceneGripper(
        name=name,
        source="tests",
        licence="Apache-2.0",
        urdf=JAW,
        meshes={},
        base_link="palm",
        carrier=(CarrierJoint(name="z", force=20.0, max_velocity=10.0),),
        joints=tuple(joints),
        finger_links=("left_finger", "right_finger"),
        approach_axis=(0.0, 0.0, 1.0),
        palm_offset=0.06,
        standoff=(0.0, 0.05),
        extent=0.2,
    )


def made_scene(gripper: str = "jaw", hulls: bytes | None = None) -> Scene:
    """A scene of the jaw, called `gripper`, and a block with these hulls in its mesh frame."""
    box = trimesh.creation.box((0.04, 0.05, 0.06))
    body = SceneObject(
        name="block",
        source="tests",
        licence="Apache-2.0",
        collision_source="own parts",
        mass=0.1,
        lateral_friction=0.5,
        rolling_friction=0.01,
        spinning_friction=0.1,
        com_in_mesh=(0.0, 0.0, 0.0),
        collision=trimesh.exchange.obj.export_obj(box).encode() if hulls is None else hulls,
        mesh_vertices=box.vertices.astype("<f4").tobytes(),
        mesh_faces=box.faces.astype("<u4").tobytes(),
    )
    low, high = (tuple(corner) for corner in box.bounds.tolist())
    empty = np.zeros((0, 3), "<f4").tobytes()
    return Scene(
        protocol="paper",
        gripper=jaw(gripper),
        object=body,
        points=empty,
        normals=empty,
        finder_low=low,
        finder_high=high,
        object_low=low,
        object_high=high,
    )


def restricted_scene() -> Scene:
    """A scene whose block may be touched above its middle alone, with a wall beside it."""
    scene, wall = made_scene(), mesh.box((0.02, 0.2, 0.2)).moved((0.2, 0.0, 0.0))
    points, _ = sample_surface(scene.object.mesh, 1 << 13, seed=0)
    top = Region(name="top", mask=np.packbits(points[:, 2] > 0).tobytes(), is_allowed=True)
    return replace(scene, regions=(top,), neighbours=mesh.parts_to_obj([wall]))
