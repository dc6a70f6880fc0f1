"""Renders snapshots of an evaluation by casting rays, and places the camera.

It needs no physics engine. The hand is drawn as its collision shapes, which are simulated. Each body has a
ray tracing scene of its own, in its own frame, that is built once: for a picture the camera is moved into
that frame, and a ray is cast through each pixel near which the body can be. The nearest body is drawn.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.mesh import read_obj
from qdgrasp_assets.geometry.proximity import ray_scene
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.collision_shapes import shapes
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.replay_messages import ContactPoint, Phase, ReplayCamera


@dataclass(frozen=True)
class Snapshot:
    """State of hand and object before or after a step."""

    phase: Phase
    step: int
    """Steps of 1/240 s since the phase began."""
    root: tuple[Sequence[float], Sequence[float]]
    """Position [m] and quaternion xyzw of the carrier's root link, object's CoM frame at first."""
    joints: Mapping[str, float]
    """Positions of all joints that move, by name [rad or m]."""
    object: tuple[Sequence[float], Sequence[float]]
    """Position [m] and quaternion xyzw of the object, in the same frame."""
    touches: tuple[ContactPoint, ...]
    """The contacts of the last look at them."""


FIELD_OF_VIEW = np.radians(28.0)  # From the lower to the upper edge of a picture [rad]
FILLED_SHARE = 0.94  # Share of the picture that is filled, to the farthest point
NEAR, FAR = 0.1, 10.0  # Bounds of the drawn depth, as shares of the distance [-]


@dataclass(frozen=True)
class CameraMatrices:
    """A camera with the object's z upward."""

    azimuth: float
    """Angle from the object's x towards its y [deg]."""
    elevation: float
    """Angle above the object's xy plane [deg]."""
    view: Floats
    """(4, 4): from the world to the camera, which looks along its -z."""
    projection: Floats
    """(4, 4): from the camera to clip coordinates."""
    near: float
    """Depth before which nothing is drawn [m]."""
    far: float
    """Depth behind which nothing is drawn [m]."""

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
    near, far = NEAR * distance, FAR * distance
    return CameraMatrices(azimuth, elevation, view, _projection(aspect, near, far), near, far)


def _camera_axes(azimuth: float, elevation: float) -> Floats:
    """The camera's axes (3, 3), a row each: to the right, upward, and back to the camera."""
    back = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    return np.array([right, np.cross(back, right), back])


def _projection(aspect: float, near: float, far: float) -> Floats:
    """(4, 4): that of OpenGL's gluPerspective."""
    slope = np.tan(FIELD_OF_VIEW / 2)
    depth, shift = (far + near) / (near - far), 2 * far * near / (near - far)
    return np.array(
        [[1 / (slope * aspect), 0, 0, 0], [0, 1 / slope, 0, 0], [0, 0, depth, shift], [0, 0, -1, 0]]
    )


CLAY, STEEL, BLUE = (0.93, 0.84, 0.70), (0.66, 0.70, 0.75), (0.21, 0.48, 0.76)
"""Colours of the object, the hand, and the links whose touch makes a success."""
AMBIENT, DIFFUSE = 0.60, 0.46  # Light on every surface, and more on one that faces the lamp
LIGHT_DIRECTION = (-1 / 3, 2 / 3, 2 / 3)
"""Unit direction to the lamp in the camera's axes: over the viewer's left shoulder."""
NOTHING, NO_LINK = -1, -1  # No triangle, no link of the hand
RAYS_AT_ONCE = 1 << 18  # Rays that are cast at a time: a few tens of bytes each


@dataclass(frozen=True)
class DrawnBody:
    """A rigid body with its surface for rays, in its own frame."""

    triangles: Floats
    """(f, 3, 3): corners of its triangles [m]."""
    colour: tuple[float, float, float]
    """Red, green and blue, 0 to 1."""
    rays: Any = field(init=False, repr=False)
    normals: Floats = field(init=False, repr=False)
    """(f, 3), unit; zeros for triangles without area."""
    corners: Floats = field(init=False, repr=False)
    """(8, 3): corners of the box around it [m]."""

    def __post_init__(self) -> None:
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        crosses = np.cross(b - a, c - a)
        lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
        sides = zip(self.triangles.min(axis=(0, 1)), self.triangles.max(axis=(0, 1)), strict=True)
        object.__setattr__(self, "rays", ray_scene(self.triangles))
        object.__setattr__(self, "normals", crosses / np.where(lengths > 0, lengths, 1.0))
        object.__setattr__(self, "corners", np.array(list(product(*sides))))

    def shaded(self, eye: Floats, light: Floats) -> NDArray[np.uint8]:
        """The colours (f, 3) of the triangles, on the sides that are seen from `eye` (3,) [m].

        `light` (3,) is the unit direction to the lamp.
        """
        is_turned = np.einsum("fi,fi->f", self.normals, eye - self.triangles[:, 0]) < 0
        towards = np.einsum("fi,i->f", self.normals, light) * np.where(is_turned, -1.0, 1.0)
        shares = np.multiply.outer(AMBIENT + DIFFUSE * np.maximum(towards, 0.0), self.colour)
        colours: NDArray[np.uint8] = np.minimum(255.0 * shares, 255.0).astype(np.uint8)
        return colours


@dataclass(frozen=True)
class SegmentationMask:
    """The body and link at each pixel of a picture."""

    links: NDArray[np.int64]
    """(rows, columns): the hand's link seen there, its place in `Renderer.links`; `NO_LINK` off the hand."""
    is_object: NDArray[np.bool_]
    """(rows, columns): where the object is seen."""


class Renderer:
    """Pictures of a scene; the object is drawn as its convex `parts`, or as its surface."""

    def __init__(self, scene: Scene, *, parts: bool = False) -> None:
        gripper = scene.gripper
        self._robot = parse_robot(Path(gripper.name), ET.fromstring(gripper.urdf))  # noqa: S314  # the scene's own
        found: dict[str, list[Floats]] = {}
        for shape in shapes(self._robot, gripper.meshes):
            found.setdefault(shape.link, []).append(shape.vertices[shape.faces])
        self.links = tuple(found)
        """The links of the hand that have a shape."""
        self.fingers = frozenset(self.links.index(link) for link in gripper.finger_links if link in found)
        """The links whose touch makes a success, by their place in `links`."""
        self._bodies = [
            DrawnBody(np.concatenate(triangles), BLUE if i in self.fingers else STEEL)
            for i, triangles in enumerate(found.values())
        ]
        drawn = scene.object.triangles.astype(np.float64)
        if parts:
            read = read_obj(scene.object.collision.decode())
            drawn = read.vertices[np.concatenate(read.groups)]
        self._bodies.append(DrawnBody(drawn, CLAY))
        self._first = np.cumsum([0, *(len(body.triangles) for body in self._bodies)])

    def place(self, snapshot: Snapshot) -> None:
        """Put hand and object at the poses of a snapshot."""
        frames = self._robot.forward(snapshot.joints, frame_of(snapshot.root))
        self._frames = [*(frames[link] for link in self.links), frame_of(snapshot.object)]

    def corners(self) -> Floats:
        """(n, 3) [m]: corners of boxes that hold all bodies; the object's eight stand last."""
        placed = zip(self._bodies, self._frames, strict=True)
        return np.concatenate([body.corners @ frame[:3, :3].T + frame[:3, 3] for body, frame in placed])

    def draw(self, camera: CameraMatrices, width: int, height: int) -> NDArray[np.uint8]:
        """Draw all bodies on white: (rows, columns, 3)."""
        light = camera.view[:3, :3].T @ LIGHT_DIRECTION
        colours = [
            body.shaded(_in_body(frame, camera)[:3, 3], frame[:3, :3].T @ light)
            for body, frame in zip(self._bodies, self._frames, strict=True)
        ]
        table = np.concatenate([*colours, np.full((1, 3), 255, dtype=np.uint8)])  # NOTHING is its last
        return np.take(table, self._see(camera, width, height), axis=0)

    def segment(self, camera: CameraMatrices, width: int, height: int) -> SegmentationMask:
        """Return the body and link at each pixel of the present picture."""
        seen = self._see(camera, width, height)
        bodies = np.searchsorted(self._first, seen, side="right") - 1
        is_object = bodies == len(self.links)
        return SegmentationMask(np.where(is_object, NO_LINK, bodies), is_object)

    def _see(self, camera: CameraMatrices, width: int, height: int) -> NDArray[np.int32]:
        """The triangle at each pixel (rows, columns), counted through all bodies, or `NOTHING`."""
        seen = np.full((height, width), NOTHING, dtype=np.int32)
        depth = np.full((height, width), camera.far - camera.near, dtype=np.float32)
        slopes = 1 / np.diagonal(camera.projection)[:2]
        x = (slopes[0] * ((2 * np.arange(width) + 1) / width - 1)).astype(np.float32)
        y = (slopes[1] * (1 - (2 * np.arange(height) + 1) / height)).astype(np.float32)
        for body, frame, first in zip(self._bodies, self._frames, self._first, strict=False):
            rows, columns = window(camera, frame, body.corners, width, height)
            step = RAYS_AT_ONCE // max(1, columns.stop - columns.start)
            right, up, back, eye = _in_body(frame, camera)[:3].T.astype(np.float32)
            across = x[columns, None] * right
            for top in range(rows.start, rows.stop, step):
                part = slice(top, min(top + step, rows.stop)), columns
                # a unit of a ray is one metre of depth, so that depths of different bodies compare
                ways = (across + (y[part[0], None] * up - back)[:, None]).reshape(-1, 3)
                found = body.rays.run(eye + np.float32(camera.near) * ways, ways, output=1)
                shape = depth[part].shape
                far, faces = found["tfar"].reshape(shape), found["primID"].reshape(shape)
                nearer = (faces >= 0) & (far < depth[part])
                depth[part][nearer] = far[nearer]
                seen[part][nearer] = faces[nearer] + first
        return seen


def _in_body(frame: Floats, camera: CameraMatrices) -> Floats:
    """Return the camera in a body's frame, (4, 4): columns right, up, back, eye."""
    return np.asarray(np.linalg.inv(camera.view @ frame), dtype=np.float64)


def window(
    camera: CameraMatrices, frame: Floats, corners: Floats, width: int, height: int
) -> tuple[slice, slice]:
    """Return the rows and columns of a picture in which a box is seen.

    `corners` (8, 3) [m] are in the box's own frame, which stands at `frame` (4, 4). For a box that reaches up
    to the camera it is the whole picture.
    """
    whole = np.column_stack([corners, np.ones(len(corners))])
    clip = whole @ (camera.projection @ camera.view @ frame).T
    if clip[:, 3].min() <= camera.near:
        return slice(0, height), slice(0, width)
    middle, half = np.array([height, width]) / 2, np.array([-height, width]) / 2
    pixels = middle + half * (clip[:, :2] / clip[:, 3:])[:, ::-1]
    low = np.clip(np.floor(pixels.min(axis=0)), 0, [height, width]).astype(int).tolist()
    high = np.clip(np.ceil(pixels.max(axis=0)), 0, [height, width]).astype(int).tolist()
    return slice(low[0], high[0]), slice(low[1], high[1])


def frame_of(pose: tuple[Sequence[float], Sequence[float]]) -> Floats:
    """The frame (4, 4) of a position [m] and a quaternion xyzw."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_quat(pose[1]).as_matrix(), pose[0]
    return frame


AZIMUTHS, ELEVATIONS = range(0, 360, 20), (12, 30)  # The camera's directions that are tried [deg]
OBJECT_CORNERS = -8  # Index in `Renderer.corners` at which the object's begin
PREVIEW_SIZE = (160, 120)  # Columns and rows of a picture whose pixels are only counted


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
