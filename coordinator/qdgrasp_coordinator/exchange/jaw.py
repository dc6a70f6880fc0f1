"""Grasps as data sets of parallel jaws tell them: matrices of axes with +z forward and x across.

ACRONYM and GraspGen share these. The origin stays that of the hand's root link; its axes are turned so that
+z points to the object and the fingers open along x (`frames.jaw_turn`), for the Panda by 90 degrees about z.
"""

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.frames import jaw_turn, to_matrices, turned
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_protocol.phrases import plain

MATRICES = "none: rotations are matrices, columns are the axes of the hand"


def transforms(grasps: Grasps, about: About) -> Floats:
    """(n, 4, 4): where the turned axes are in the object's frame [m]."""
    return to_matrices(turned(grasps.poses(about.frame), jaw_turn(grasps.scene.gripper)))


def turned_about(about: About, gripper: SceneGripper) -> About:
    """What such a file says of its axes."""
    across = (
        f"x from one finger to the other, along ({plain(gripper.jaw.axis)}) of it"
        if gripper.jaw
        else "x at right angles to it, for the hand has no jaw"
    )
    turn = ", ".join(f"{value:.9g}" for value in jaw_turn(gripper) + 0.0)
    words = (
        f"origin of link '{gripper.base_link}'; +z approaches, along ({plain(gripper.approach_axis)}) of the "
        f"link; {across}: link axes turned by the quaternion (x, y, z, w) = ({turn})"
    )
    return about.told(axes=words, quaternions=MATRICES)
