"""Frames that grasps are given in, an object's surface there; distances of poses."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats, from_frame, multiply, rotate, tangents
from qdgrasp_assets.gripper_setup.draft import original_base
from qdgrasp_assets.grippers.gripper_file import OriginalBase
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import SceneGripper, SceneObject
from qdgrasp_protocol.errors import UnknownName

Frame = Literal["mesh", "com"]
MESH: Frame = "mesh"
COM: Frame = "com"
FRAMES: tuple[Frame, ...] = get_args(Frame)


def frame_of(name: str) -> Frame:
    """Return the object's frame of that name; raises UnknownName."""
    for frame in FRAMES:
        if frame == name:
            return frame
    raise UnknownName("frame", name, FRAMES)


def change_frame(poses: Floats, com_in_mesh: ArrayLike, source: Frame, target: Frame) -> Floats:
    """Move poses (n, 7), xyz [m] and xyzw, or points (n, 3), between frames of the object."""
    found = poses.copy()
    found[:, :3] += (FRAMES.index(source) - FRAMES.index(target)) * np.asarray(com_in_mesh)
    return found


def turn_hand_axes(poses: Floats, rotation: Floats) -> Floats:
    """Turn the hand's own axes of poses (n, 7) by a quaternion (4,), xyzw."""
    rotations = np.broadcast_to(rotation, (len(poses), 4))
    return np.hstack([poses[:, :3], multiply(poses[:, 3:], rotations)])


def scene_original_base(gripper: SceneGripper) -> OriginalBase | None:
    """Return the base link of a hand's own URDF, where `--repair` added another; else None."""
    element = ET.fromstring(gripper.urdf)  # noqa: S314  # a scene that was read and checked
    return original_base(gripper.base_link, parse_robot(Path(gripper.name), element))


def to_matrices(poses: Floats) -> Floats:
    """Convert poses (n, 7) to homogeneous matrices (n, 4, 4)."""
    quaternions = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    matrices = np.zeros((len(poses), 4, 4))
    for column, axis in enumerate(np.eye(3)):
        matrices[:, :3, column] = rotate(quaternions, np.broadcast_to(axis, (len(poses), 3)))
    matrices[:, :3, 3], matrices[:, 3, 3] = poses[:, :3], 1.0
    return matrices


def from_matrices(matrices: Floats) -> Floats:
    """Convert homogeneous matrices to poses, the inverse of `to_matrices`, with w >= 0."""
    x, y, z = np.moveaxis(matrices[:, :3, :3], 2, 0)
    return np.hstack([matrices[:, :3, 3], from_frame(x, y, z)])


def jaw_turn(gripper: SceneGripper) -> Floats:
    """Rotation (4,), xyzw, from a hand's root link to axes with +z toward the object, x across.

    x is the axis along which the two fingers of a jaw open; of a hand without a jaw it is the first of two
    tangents to its approach axis (`rotation.tangents`), which is its own x if that axis is +z.
    """
    z = np.array([gripper.approach_axis])
    x = np.array([gripper.jaw.axis]) if gripper.jaw else tangents(z)[0]
    return np.asarray(from_frame(x, np.cross(z, x), z)[0])


def object_mesh(body: SceneObject, frame: Frame) -> Mesh:
    """Return the surface of a scene's object in one of its frames [m]."""
    vertices = body.vertices.astype(np.float64) + (0.0 if frame == COM else np.array(body.com_in_mesh))
    faces = np.frombuffer(body.mesh_faces, dtype="<u4").reshape(-1, 3).astype(np.int64)
    return Mesh(vertices, faces)


def squared_distances(poses: Floats, other: Floats, hand: SceneGripper) -> Floats:
    """Return the squared distances (n,) [m2] of poses (n, 7) from another one (7,)."""
    apart, cosine = poses[:, :3] - other[:3], _half_angle_cosines(poses[:, 3:], other[3:])
    if hand.jaw:
        half = np.array([*hand.approach_axis, 0.0])  # the quaternion of 180 degrees
        cosine = np.maximum(
            cosine, _half_angle_cosines(poses[:, 3:], multiply(other[None, 3:], half[None])[0])
        )
    x, y, z = apart.T
    return np.asarray(x * x + y * y + z * z + 4.0 * hand.reach**2 * (1.0 - np.minimum(cosine, 1.0) ** 2))


def _half_angle_cosines(quaternions: Floats, other: Floats) -> Floats:
    """Cosine (n,) of half the angle between rotations (n, 4) and another one (4,)."""
    x, y, z, w = quaternions.T
    return np.asarray(np.abs(x * other[0] + y * other[1] + z * other[2] + w * other[3]))
