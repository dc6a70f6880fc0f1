"""The skeleton: where a hand's links are in its postures, and the convex parts that they carry."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from qdgrasp_assets.hulls import convex_parts, is_all_convex
from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_assets.urdf import tree
from qdgrasp_worker.convex import Hull, hulls


class Skeleton:
    """The links of a scene's hand from its root link outward, without the carrier."""

    def __init__(self, gripper: SceneGripper) -> None:
        robot = tree(Path(), ET.fromstring(gripper.urdf))  # noqa: S314  # the scene's own
        self.robot = robot.subtree(gripper.base_link)
        """The hand, without meshes and without the carrier."""
        self._joints = [joint.name for joint in gripper.joints]
        parts = list(convex_parts(self.robot, gripper.meshes))
        self.hulls: dict[str, list[Hull]] = {
            link: hulls(part.corners for part in parts if part.link == link) for link in self.robot.links
        }
        """The convex parts of each link, link frame."""
        self.is_whole = is_all_convex(robot, gripper.meshes) and (
            sum(map(len, self.hulls.values())) == len(list(convex_parts(robot, gripper.meshes)))
        )
        """Whether these are all collision shapes: none is unknown or flat, and none is the carrier's."""

    def frames(self, postures: Floats) -> dict[str, Floats]:
        """Each link's frame (n, 4, 4) in the hand's, with the joints at `postures` (n, j) [rad or m]."""
        frames = self.robot.forward(dict(zip(self._joints, postures.T, strict=True)))
        shape = (len(postures), 4, 4)
        return {link: np.broadcast_to(frame, shape) for link, frame in frames.items()}

    def box(self, links: Iterable[str], frames: dict[str, Floats]) -> tuple[Floats, Floats]:
        """The corners (3,) of the box around `links` in all of the `frames` [m]."""
        corners = [
            np.einsum("nij,kj->nki", frames[link][:, :3, :3], hull.triangles.reshape(-1, 3))
            + frames[link][:, None, :3, 3]
            for link in links
            for hull in self.hulls[link]
        ]
        points = np.concatenate([each.reshape(-1, 3) for each in [*corners, np.zeros((1, 3))]])
        return points.min(axis=0), points.max(axis=0)
