"""The eye: the other module that imports PyBullet, for what only those want to know who look.

It reads contacts in full where an evaluation happens, without a say in it; and it draws what is remembered of
one in a world of its own, with PyBullet's renderer for machines without a screen.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Scene, SceneObject
from qdgrasp_protocol.replay import Touch
from qdgrasp_worker.bodies import Hand, load
from qdgrasp_worker.bullet import BASE, Bullet
from qdgrasp_worker.quiet import quiet
from qdgrasp_worker.replaying.lens import Lens
from qdgrasp_worker.replaying.moment import Moment

with quiet():
    import pybullet as pb

CLAY, STEEL, BLUE = (0.93, 0.84, 0.70, 1.0), (0.66, 0.70, 0.75, 1.0), (0.21, 0.48, 0.76, 1.0)
"""The object, the hand, and those of its links whose touch makes a success."""
LIGHT = {"lightAmbientCoeff": 0.58, "lightDiffuseCoeff": 0.46, "lightSpecularCoeff": 0.03}
LAMP = (-0.5, 1.0, 1.0)
"""Whence the light comes, in the camera's axes: over the left shoulder of whoever looks."""
OBJECT_URDF = """<robot name="object"><link name="object">
<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><mesh filename="shape.obj"/></geometry></collision>
</link></robot>
"""
"""The renderer draws the shape that collides where there is no other."""
LINK_BITS = 24
"""Where in a number of the renderer's mask the link begins; below it is the body."""
NOTHING = -2
"""No link: neither a number nor the root."""


def pose(bullet: Bullet, body: int) -> tuple[list[float], list[float]]:
    """Position [m] and quaternion xyzw of a body's root link, by its centre of mass."""
    position, quaternion = pb.getBasePositionAndOrientation(body, physicsClientId=bullet._client)
    return list(position), list(quaternion)


def touches(
    bullet: Bullet, hand: int, target: int, links: Mapping[int, str], fingers: Collection[int]
) -> tuple[Touch, ...]:
    """The contacts of a hand with an object, of the last collision detection.

    Parameters
    ----------
    links
        The names of the hand's links by number.
    fingers
        The numbers of those whose touch makes a success.
    """
    found = pb.getContactPoints(hand, target, physicsClientId=bullet._client)
    return tuple(
        Touch(
            link=links[contact[3]],
            is_finger=contact[3] in fingers,
            point=contact[6],
            normal=contact[7],
            distance=contact[8],
        )
        for contact in found
    )


@dataclass(frozen=True)
class Seen:
    """What stands where in a picture."""

    links: NDArray[np.int64]
    """(rows, columns): the hand's link that is seen there, -1 its root; `NOTHING` where there is none."""
    is_object: NDArray[np.bool_]
    """(rows, columns): where the object is seen."""


class Eye:
    """A scene to be looked at; a context manager that leaves it.

    Parameters
    ----------
    parts
        Whether the object is drawn as its convex parts, instead of its surface.
    """

    def __init__(self, scene: Scene, *, parts: bool = False) -> None:
        self._bullet = Bullet()
        self._hand = Hand(self._bullet, scene.gripper)
        self._joints = [*self._hand.carrier, *self._hand.others, *self._hand.fingers]
        shape = scene.object.collision if parts else surface(scene.object)
        self._target = load(self._bullet, OBJECT_URDF, {"shape.obj": shape}, fixed=False)
        self._paint()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bullet.close()

    @property
    def fingers(self) -> frozenset[int]:
        """The links whose touch makes a success."""
        return self._hand.finger_links

    def show(self, moment: Moment) -> None:
        """Put hand and object where they were."""
        self._bullet.place(self._hand.body, *moment.root)
        self._bullet.set_joints(self._hand.body, self._joints, moment.joints)
        self._bullet.place(self._target, *moment.object)

    def corners(self) -> Floats:
        """(n, 3) [m]: the corners of boxes that hold all that is there; the object's eight stand last."""
        self._bullet.detect()
        boxes = [self._bullet.box(self._hand.body, link) for link in self._hand.shaped_links]
        lows, highs = np.moveaxis(np.array([*boxes, self._bullet.box(self._target, BASE)]), 1, 0)
        is_high = np.indices((2, 2, 2)).reshape(3, 8).T == 1
        corners: Floats = np.where(is_high, highs[:, None], lows[:, None]).reshape(-1, 3)
        return corners

    def look(self, lens: Lens, width: int, height: int) -> NDArray[np.uint8]:
        """Draw what is there: (rows, columns, 3)."""
        colours, _ = self._see(lens, width, height, shadow=False, flags=pb.ER_NO_SEGMENTATION_MASK)
        image: NDArray[np.uint8] = colours.astype(np.uint8).reshape(height, width, 4)[:, :, :3]
        return image

    def tell(self, lens: Lens, width: int, height: int) -> Seen:
        """What stands where in the picture of what is there."""
        flags = pb.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX
        _, mask = self._see(lens, width, height, shadow=False, flags=flags)
        numbers = mask.astype(np.int64).reshape(height, width)
        bodies, links = numbers & ((1 << LINK_BITS) - 1), (numbers >> LINK_BITS) - 1
        is_there = numbers >= 0
        is_hand = is_there & (bodies == self._hand.body)
        return Seen(np.where(is_hand, links, NOTHING), is_there & (bodies == self._target))

    def _see(
        self, lens: Lens, width: int, height: int, *, shadow: bool, flags: int
    ) -> tuple[NDArray[np.generic], NDArray[np.generic]]:
        """The colours and the mask of a picture."""
        _, _, colours, _, mask = pb.getCameraImage(
            width,
            height,
            viewMatrix=lens.view.T.ravel().tolist(),
            projectionMatrix=lens.projection.T.ravel().tolist(),
            lightDirection=(lens.view[:3, :3].T @ LAMP).tolist(),
            shadow=shadow,
            flags=flags,
            renderer=pb.ER_TINY_RENDERER,
            physicsClientId=self._bullet._client,
            **LIGHT,
        )
        return np.asarray(colours), np.asarray(mask)

    def _paint(self) -> None:
        for link in self._hand.shaped_links:
            self._colour(self._hand.body, link, BLUE if link in self.fingers else STEEL)
        self._colour(self._target, BASE, CLAY)

    def _colour(self, body: int, link: int, colour: tuple[float, ...]) -> None:
        pb.changeVisualShape(body, link, rgbaColor=colour, physicsClientId=self._bullet._client)


def surface(target: SceneObject) -> bytes:
    """An object's surface as an OBJ file, each triangle with corners of its own, so that edges stay sharp."""
    corners = target.triangles.reshape(-1, 3).tolist()
    vertices = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners]
    faces = [f"f {first} {first + 1} {first + 2}" for first in range(1, len(corners), 3)]
    return "\n".join(["o surface", *vertices, *faces, ""]).encode()
