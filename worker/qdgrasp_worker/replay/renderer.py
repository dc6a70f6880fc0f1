"""Renders snapshots of an evaluation with PyBullet, and places the camera.

Besides `bullet` the only module that imports PyBullet. It reads contacts in full where an evaluation
happens, without a say in it; and it draws what is remembered of one in a world of its own, with PyBullet's
renderer for machines without a screen. The camera, in OpenGL's matrices, is placed so that all of an
evaluation is in the picture.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import Scene, SceneObject
from qdgrasp_protocol.replay_messages import ContactPoint, Phase, ReplayCamera
from qdgrasp_worker.engines.bullet import BASE, Bullet, quiet
from qdgrasp_worker.engines.bullet_world import HandBody, load_body


@dataclass(frozen=True)
class Snapshot:
    """State of hand and object before or after a step."""

    phase: Phase
    step: int
    """Steps since the phase began."""
    root: tuple[list[float], list[float]]
    """Position [m] and quaternion xyzw of the carrier's root link, object's CoM frame at first."""
    joints: list[float]
    """Positions of all joints that move [rad or m], in the order of `RecordingWorld.joints`."""
    object: tuple[list[float], list[float]]
    """Position [m] and quaternion xyzw of the object, of the same frame."""
    touches: tuple[ContactPoint, ...]
    """The contacts of the last look at them."""


FIELD_OF_VIEW = np.radians(28.0)  # Of view, from the lower to the upper edge
FILLED_SHARE = 0.94  # How much of the picture is filled, to the farthest point
NEAR, FAR = 0.1, 10.0  # Bounds of the drawn depth, as shares of the distance [-]


@dataclass(frozen=True)
class CameraMatrices:
    """A camera that looks at something, with the object's z upward."""

    azimuth: float
    """From the object's x towards its y [deg]."""
    elevation: float
    """Above the object's xy plane [deg]."""
    view: Floats
    """(4, 4): from the world to the camera, which looks along its -z."""
    projection: Floats
    """(4, 4): from the camera to clip coordinates."""

    def camera(self, width: int, height: int) -> ReplayCamera:
        """The camera in the form of a replay's answer, for drawing over its pictures."""
        matrix = self.projection @ self.view
        return ReplayCamera(
            azimuth=self.azimuth,
            elevation=self.elevation,
            matrix=tuple(matrix.ravel().tolist()),
            width=width,
            height=height,
        )


def fit_camera(points: Floats, azimuth: float, elevation: float, aspect: float) -> CameraMatrices:
    """The nearest camera with all `points` (n, 3) [m] in a picture of this width over height."""
    axes = _camera_axes(np.radians(azimuth), np.radians(elevation))
    right, up, back = (points @ axes.T).T
    slope = np.tan(FIELD_OF_VIEW / 2) * FILLED_SHARE
    middle = [(side.min() + side.max()) / 2 for side in (right, up)]
    wide = np.abs(right - middle[0]) / (slope * aspect)
    high = np.abs(up - middle[1]) / slope
    away = float((back + np.maximum(wide, high)).max())
    distance = away - float(back.min())
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = axes, -np.array([*middle, away])
    return CameraMatrices(azimuth, elevation, view, _projection(aspect, NEAR * distance, FAR * distance))


def _camera_axes(azimuth: float, elevation: float) -> Floats:
    """The camera's axes (3, 3), a row each: to the right, upward, and back to the camera."""
    back = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    return np.array([right, np.cross(back, right), back])


def _projection(aspect: float, near: float, far: float) -> Floats:
    """(4, 4): that of OpenGL's gluPerspective."""
    slope = np.tan(FIELD_OF_VIEW / 2)
    depth, shift = (far + near) / (near - far), 2 * far * near / (near - far)
    return np.array(
        [[1 / (slope * aspect), 0, 0, 0], [0, 1 / slope, 0, 0], [0, 0, depth, shift], [0, 0, -1, 0]]
    )


with quiet():
    import pybullet as pb

CLAY, STEEL, BLUE = (0.93, 0.84, 0.70, 1.0), (0.66, 0.70, 0.75, 1.0), (0.21, 0.48, 0.76, 1.0)
"""The object, the hand, and those of its links whose touch makes a success."""
LIGHT_SETTINGS = {"lightAmbientCoeff": 0.58, "lightDiffuseCoeff": 0.46, "lightSpecularCoeff": 0.03}
LIGHT_DIRECTION = (-0.5, 1.0, 1.0)
"""Direction to the light in the camera's axes: over the viewer's left shoulder."""
OBJECT_URDF = """<robot name="object"><link name="object">
<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><mesh filename="shape.obj"/></geometry></collision>
</link></robot>
"""
"""The renderer draws the shape that collides where there is no other."""
LINK_BITS = 24  # Where in a number of the renderer's mask the link begins; below it is the body
NO_LINK = -2  # No link: neither a number nor the root


def body_pose(bullet: Bullet, body: int) -> tuple[list[float], list[float]]:
    """Position [m] and quaternion xyzw of a body's root link, by its centre of mass."""
    position, quaternion = pb.getBasePositionAndOrientation(body, physicsClientId=bullet._client)
    return list(position), list(quaternion)


def contact_points(
    bullet: Bullet, hand: int, target: int, links: Mapping[int, str], fingers: Collection[int]
) -> tuple[ContactPoint, ...]:
    """The contacts of a hand with an object, of the last collision detection.

    `links` are the names of the hand's links by number, `fingers` the numbers of those whose touch makes a
    success.
    """
    found = pb.getContactPoints(hand, target, physicsClientId=bullet._client)
    return tuple(
        ContactPoint(
            link=links[contact[3]],
            is_finger=contact[3] in fingers,
            point=contact[6],
            normal=contact[7],
            distance=contact[8],
        )
        for contact in found
    )


@dataclass(frozen=True)
class SegmentationMask:
    """The body and link at each pixel of a picture."""

    links: NDArray[np.int64]
    """(rows, columns): the hand's link seen there, -1 its root; `NO_LINK` off the hand."""
    is_object: NDArray[np.bool_]
    """(rows, columns): where the object is seen."""


class Renderer:
    """Pictures of a scene; a context manager that leaves it.

    The object is drawn as its convex `parts`, or as its surface.
    """

    def __init__(self, scene: Scene, *, parts: bool = False) -> None:
        self._bullet = Bullet()
        self._hand = HandBody(self._bullet, scene.gripper)
        self._joints = [*self._hand.carrier, *self._hand.others, *self._hand.fingers]
        shape = scene.object.collision if parts else surface_obj(scene.object)
        self._target = load_body(self._bullet, OBJECT_URDF, {"shape.obj": shape}, fixed=False)
        for link in self._hand.shaped_links:
            self._colour(self._hand.body, link, BLUE if link in self.fingers else STEEL)
        self._colour(self._target, BASE, CLAY)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bullet.close()

    @property
    def fingers(self) -> frozenset[int]:
        """The links whose touch makes a success."""
        return self._hand.finger_links

    def place(self, snapshot: Snapshot) -> None:
        """Put hand and object where they were."""
        self._bullet.place(self._hand.body, *snapshot.root)
        self._bullet.set_joints(self._hand.body, self._joints, snapshot.joints)
        self._bullet.place(self._target, *snapshot.object)

    def corners(self) -> Floats:
        """(n, 3) [m]: corners of boxes that hold all bodies; the object's eight stand last."""
        self._bullet.detect()
        boxes = [self._bullet.box(self._hand.body, link) for link in self._hand.shaped_links]
        lows, highs = np.moveaxis(np.array([*boxes, self._bullet.box(self._target, BASE)]), 1, 0)
        is_high = np.indices((2, 2, 2)).reshape(3, 8).T == 1
        corners: Floats = np.where(is_high, highs[:, None], lows[:, None]).reshape(-1, 3)
        return corners

    def draw(self, camera: CameraMatrices, width: int, height: int) -> NDArray[np.uint8]:
        """Draw what is there: (rows, columns, 3)."""
        colours, _ = self._see(camera, width, height, pb.ER_NO_SEGMENTATION_MASK)
        image: NDArray[np.uint8] = colours.astype(np.uint8).reshape(height, width, 4)[:, :, :3]
        return image

    def segment(self, camera: CameraMatrices, width: int, height: int) -> SegmentationMask:
        """Return the body and link at each pixel of the present picture."""
        _, mask = self._see(camera, width, height, pb.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX)
        numbers = mask.astype(np.int64).reshape(height, width)
        bodies, links = numbers & ((1 << LINK_BITS) - 1), (numbers >> LINK_BITS) - 1
        is_there = numbers >= 0
        is_hand = is_there & (bodies == self._hand.body)
        return SegmentationMask(np.where(is_hand, links, NO_LINK), is_there & (bodies == self._target))

    def _see(
        self, camera: CameraMatrices, width: int, height: int, flags: int
    ) -> tuple[NDArray[np.generic], NDArray[np.generic]]:
        _, _, colours, _, mask = pb.getCameraImage(
            width,
            height,
            viewMatrix=camera.view.T.ravel().tolist(),
            projectionMatrix=camera.projection.T.ravel().tolist(),
            lightDirection=(camera.view[:3, :3].T @ LIGHT_DIRECTION).tolist(),
            shadow=False,
            flags=flags,
            renderer=pb.ER_TINY_RENDERER,
            physicsClientId=self._bullet._client,
            **LIGHT_SETTINGS,
        )
        return np.asarray(colours), np.asarray(mask)

    def _colour(self, body: int, link: int, colour: tuple[float, ...]) -> None:
        pb.changeVisualShape(body, link, rgbaColor=colour, physicsClientId=self._bullet._client)


def surface_obj(target: SceneObject) -> bytes:
    """An object's surface as an OBJ file; triangles share no corners, so that edges stay sharp."""
    corners = target.triangles.reshape(-1, 3).tolist()
    vertices = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners]
    faces = [f"f {first} {first + 1} {first + 2}" for first in range(1, len(corners), 3)]
    return "\n".join(["o surface", *vertices, *faces, ""]).encode()


AZIMUTHS, ELEVATIONS = range(0, 360, 20), (12, 30)  # The sides that are tried [deg]
OBJECT_CORNERS = -8  # Where in the corners of all that is there those of the object begin
PREVIEW_SIZE = (160, 120)  # Columns and rows of a picture that is only counted


def best_view(renderer: Renderer, still: Snapshot) -> tuple[float, float]:
    """Azimuth and elevation [deg] from which the most of both fingers and object is seen."""
    corners = corners_around(renderer, [still], still)
    renderer.place(still)

    def score(view: tuple[int, int]) -> float:
        seen = renderer.segment(fit_camera(corners, *view, PREVIEW_SIZE[0] / PREVIEW_SIZE[1]), *PREVIEW_SIZE)
        fingers = np.isin(seen.links, list(renderer.fingers)).sum()
        return float(fingers * seen.is_object.sum())

    azimuth, elevation = max(product(AZIMUTHS, ELEVATIONS), key=score)
    return float(azimuth), float(elevation)


def corners_around(renderer: Renderer, snapshots: Iterable[Snapshot], still: Snapshot) -> Floats:
    """(n, 3) [m]: corners around hand and object in all snapshots, without a lost object."""
    renderer.place(still)
    corners = [renderer.corners()]
    for snapshot in snapshots:
        renderer.place(snapshot)
        here = renderer.corners()
        corners.append(here if snapshot.touches else here[:OBJECT_CORNERS])
    return np.concatenate(corners)
