"""A hand by its name or file: its joints, and its shapes as a scene."""

import os
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.errors import ImpossibleValue

if TYPE_CHECKING:
    from trimesh import Scene as TrimeshScene

AT_ORIGIN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
PROTOCOL = "paper"  # Whose carrier it is mounted on; its links and joints are the same in all


class Hand:
    """A gripper, as it is simulated.

    `gripper` is a built-in name, one on the asset path, or a gripper's TOML file, as everywhere; or the
    gripper of a scene. Raises InputError for another one, AssetError if a file cannot be used.

    Examples
    --------
    >>> hand = qdgrasp.Hand("panda")
    >>> hand.joint_names, hand.opened, hand.closed
    (('panda_finger_joint1', 'panda_finger_joint2'), array([0.04, 0.04]), array([0., 0.]))
    >>> hand.scene(hand.closed).export("panda.glb")
    """

    def __init__(self, gripper: str | os.PathLike[str] | SceneGripper) -> None:
        if isinstance(gripper, SceneGripper):
            self.gripper = gripper
            """Links, joints and shapes, as a scene holds them."""
            return
        self.gripper = find_gripper(os.fspath(gripper)).on_carrier(PROTOCOL)

    def __repr__(self) -> str:
        return f"qdgrasp.Hand({self.name!r})"

    @property
    def name(self) -> str:
        """Its name."""
        return self.gripper.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The finger joints, in the order of all arrays of joints."""
        return tuple(joint.name for joint in self.gripper.joints)

    @cached_property
    def opened(self) -> NDArray[np.float64]:
        """(j,): the finger joints of the open hand [rad or m]."""
        return np.array([joint.opened for joint in self.gripper.joints])

    @cached_property
    def closed(self) -> NDArray[np.float64]:
        """(j,): the finger joints of the hand closed on nothing [rad or m]."""
        return np.array([joint.closed for joint in self.gripper.joints])

    def scene(self, joints: ArrayLike | None = None) -> "TrimeshScene":
        """Return the hand as a scene of trimesh, in metres.

        Parameters
        ----------
        joints
            (j,): finger joints [rad or m]; None: open.

        Returns
        -------
        scene
            Nodes `hand`, the frame of the root link, which is that of the scene; and below it `hand/LINK`,
            the collision shapes of each link.

        Raises
        ------
        ImpossibleValue
            The joints are not j finite numbers.
        """
        from qdgrasp_tools.rendering.views import hand_scene  # takes its time to load

        try:
            values = self.opened if joints is None else np.asarray(joints, dtype=np.float64)
        except (TypeError, ValueError):
            values = np.array(np.nan)
        if values.shape != self.opened.shape or not np.isfinite(values).all():
            expected = f"{len(self.opened)} finite numbers, of {', '.join(self.joint_names)}"
            raise ImpossibleValue("joints", joints, expected)
        return hand_scene(self.gripper, AT_ORIGIN, values)
