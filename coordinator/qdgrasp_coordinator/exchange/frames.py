"""Frames: where the poses of grasps are told, and which axes of a hand tell them.

Of the object there are two frames with the same axes: `mesh`, that of its mesh file in metres, and `com`,
whose origin is the centre of mass. Of the hand there is the frame of its root link, and for data sets of
parallel jaws one that is only turned against it: +z towards the object, fingers opening along x.
"""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.rotation import Floats, from_frame, multiply, rotate, tangents
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.errors import UnknownName

Frame = Literal["mesh", "com"]
MESH: Frame = "mesh"
COM: Frame = "com"
FRAMES: tuple[Frame, ...] = get_args(Frame)


def frame_of(name: str) -> Frame:
    """The object's frame of that name.

    Raises
    ------
    UnknownName
        There is none.
    """
    for frame in FRAMES:
        if frame == name:
            return frame
    raise UnknownName("frame", name, FRAMES)


def moved(poses: Floats, com_in_mesh: ArrayLike, source: Frame, target: Frame) -> Floats:
    """Poses (n, 7), xyz [m] and xyzw, told in one frame of the object, as another frame tells them."""
    found = poses.copy()
    found[:, :3] += (FRAMES.index(source) - FRAMES.index(target)) * np.asarray(com_in_mesh)
    return found


def turned(poses: Floats, turn: Floats) -> Floats:
    """Poses (n, 7) of hands whose own axes are turned by a quaternion (4,), xyzw, first."""
    turns = np.broadcast_to(turn, (len(poses), 4))
    return np.hstack([poses[:, :3], multiply(poses[:, 3:], turns)])


def to_matrices(poses: Floats) -> Floats:
    """Poses (n, 7) as homogeneous matrices (n, 4, 4)."""
    quaternions = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    matrices = np.zeros((len(poses), 4, 4))
    for column, axis in enumerate(np.eye(3)):
        matrices[:, :3, column] = rotate(quaternions, np.broadcast_to(axis, (len(poses), 3)))
    matrices[:, :3, 3], matrices[:, 3, 3] = poses[:, :3], 1.0
    return matrices


def from_matrices(matrices: Floats) -> Floats:
    """The inverse of `to_matrices`, with w >= 0."""
    x, y, z = np.moveaxis(matrices[:, :3, :3], 2, 0)
    return np.hstack([matrices[:, :3, 3], from_frame(x, y, z)])


def jaw_turn(gripper: SceneGripper) -> Floats:
    """The rotation (4,), xyzw, from a hand's root link to axes with +z towards the object and x across.

    x is the axis along which the two fingers of a jaw open; of a hand without a jaw it is the first of two
    tangents to its approach axis (`rotation.tangents`), which is its own x where it looks along +z.
    """
    z = np.array([gripper.approach_axis])
    x = np.array([gripper.jaw.axis]) if gripper.jaw else tangents(z)[0]
    turn: Floats = from_frame(x, np.cross(z, x), z)[0]
    return turn
