"""The geometry of a scene's hand: placed links, convex parts, drawn shapes and points on it.

All of it depends on the hand alone, and the evaluation's filters, the pictures and the page derive theirs
from it: convex parts are what the simulator makes of collision shapes, shapes are the triangles drawn.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import cached_property, lru_cache
from itertools import combinations

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Mesh, join
from qdgrasp_assets.geometry.rotation import Floats, dot
from qdgrasp_assets.geometry.voxels import Hull, Singles, convex_hulls
from qdgrasp_assets.grippers.collision_shapes import CollisionShape, collision_elements, part_corners, shapes
from qdgrasp_assets.grippers.urdf import MOVING, Urdf, edges, scene_robot
from qdgrasp_assets.scene import SceneGripper

HANDS_KEPT = 8  # Hands whose geometry a process keeps, the last ones used


def hand_geometry(gripper: SceneGripper) -> "HandGeometry":
    """Return the geometry of a scene's hand; scenes with the same hand share one object."""
    return _unpacked_geometry(msgspec.msgpack.encode(gripper, order="deterministic"))


@lru_cache(HANDS_KEPT)
def _unpacked_geometry(packed: bytes) -> "HandGeometry":
    return HandGeometry(msgspec.msgpack.decode(packed, type=SceneGripper))


class HandGeometry:
    """The links of a scene's hand from its root link outward, without the carrier.

    Joints are in the gripper's order throughout.
    """

    def __init__(self, gripper: SceneGripper) -> None:
        self.gripper = gripper
        self.whole = scene_robot(gripper)
        self.robot = self.whole.subtree(gripper.base_link)
        self._joints = [joint.name for joint in gripper.joints]

    @cached_property
    def hulls(self) -> dict[str, list[Hull]]:
        """The convex parts of each link, link frame; flat ones are left out."""
        parts: dict[str, list[Floats]] = {link: [] for link in self.robot.links}
        for link, collision in collision_elements(self.robot):
            parts[link] += part_corners(self.robot, collision, self.gripper.meshes)
        return {link: convex_hulls(corners) for link, corners in parts.items()}

    @cached_property
    def is_understood(self) -> bool:
        """True if all collision shapes are in `hulls`: all convex, none flat, none the carrier's."""
        collisions = (each for _, each in collision_elements(self.whole))
        parts = [len(list(part_corners(self.whole, each, self.gripper.meshes))) for each in collisions]
        return all(parts) and sum(map(len, self.hulls.values())) == sum(parts)

    @cached_property
    def samples(self) -> "HandSurfaceSamples":
        """Sample points on and in its convex parts."""
        return HandSurfaceSamples(self)

    @cached_property
    def shapes(self) -> tuple[CollisionShape, ...]:
        """Collision shapes as triangles, as they are drawn."""
        return tuple(shapes(self.robot, self.gripper.meshes))

    @cached_property
    def link_meshes(self) -> dict[str, Mesh]:
        """The shapes of each link that has any, joined, in the link's frame [m]."""
        names = dict.fromkeys(shape.link for shape in self.shapes)
        return {name: join(shape for shape in self.shapes if shape.link == name) for name in names}

    def frames(self, postures: Floats) -> dict[str, Floats]:
        """The frame (n, 4, 4) of each link in the hand's, joints at `postures` (n, j) [rad or m]."""
        frames = self.robot.forward(dict(zip(self._joints, postures.T, strict=True)))
        shape = (len(postures), 4, 4)
        return {link: np.broadcast_to(frame, shape) for link, frame in frames.items()}

    def link_frames(self, base_to_object: Floats, joints: Floats) -> dict[str, Floats]:
        """Return each link's frame (..., 4, 4) in the object's CoM frame.

        `base_to_object` (..., 7) is position [m] and quaternion xyzw of the hand's root link, `joints`
        (..., j) are finger joint positions [rad or m].
        """
        from scipy.spatial.transform import Rotation  # slow to import

        positions = dict(zip(self._joints, np.moveaxis(joints, -1, 0), strict=True))
        base = np.tile(np.eye(4), (*base_to_object.shape[:-1], 1, 1))
        base[..., :3, :3] = Rotation.from_quat(base_to_object[..., 3:]).as_matrix()
        base[..., :3, 3] = base_to_object[..., :3]
        return self.robot.forward(positions, base)

    def place_meshes(self, base_to_object: Floats, joints: Floats) -> Iterator[tuple[CollisionShape, Floats]]:
        """Yield each shape with its vertices (v, 3) [m] in the object's CoM frame.

        `base_to_object` (7,) and `joints` (j,) as in `link_frames`.
        """
        frames = self.link_frames(base_to_object, joints)
        for shape in self.shapes:
            frame = frames[shape.link]
            yield shape, shape.vertices @ frame[:3, :3].T + frame[:3, 3]


def rigid_pieces(element: ET.Element) -> dict[str, str]:
    """Map each link of a `<robot>` to the first link of its rigid piece."""
    names = [link.get("name", "") for link in element.findall("link")]
    pieces = dict(zip(names, names, strict=True))
    for joint, (parent, child) in zip(element.findall("joint"), edges(element), strict=True):
        if joint.get("type") not in MOVING and {parent, child} <= pieces.keys():
            old, new = pieces[child], pieces[parent]
            pieces = {name: new if piece == old else piece for name, piece in pieces.items()}
    return pieces


def neighbours(robot: Urdf) -> set[tuple[str, str]]:
    """Return pairs of links, in order of name, with at most one moving joint between them."""
    heads = rigid_pieces(robot.element)
    joined = {frozenset((heads[joint.parent], heads[joint.child])) for joint in robot.joints}
    return {pair for pair in combinations(sorted(heads), 2) if frozenset(map(heads.get, pair)) in joined}


SAMPLE_POINTS = 1024
STAGES = (slice(0, 64), slice(64, 256), slice(256, 1024))  # Points that are looked up one after the other
POINTS_AT_ONCE = 1 << 15  # Points that are looked up at once: they fit in the cache
DRAWN_POINTS = 4096  # Number of points that are drawn; those farthest apart are kept
DEEP_SHARE = 0.4  # Share of points that are drawn from inside a part, and not from under its surface
SURFACE_SCALE = 0.98  # Scale of a part's surface about its centre: points of the edge would be on either side


class HandSurfaceSamples:
    """Sample points of a hand, link by link."""

    def __init__(self, hand: HandGeometry) -> None:
        self._hand = hand
        self._names = list(hand.hulls)
        self._opened = hand.frames(np.array([[joint.opened for joint in hand.gripper.joints]]))
        self._links, self._points = self._sample()
        self._corners = {
            name: np.unique(np.concatenate([hull.surface.corners.reshape(-1, 3) for hull in hulls]), axis=0)
            for name, hulls in self._hand.hulls.items()
            if hulls
        }
        """The corners (v, 3) [m] of the convex parts of each link, link frame."""

    def points(self, postures: NDArray[np.float32], some: slice) -> Singles:
        """`some` of the points in the hand frame [m], for joints at `postures` (n, j): (n, p, 3).

        (1, p, 3) where the postures are all the same.
        """
        links, points = self._links[some], self._points[some]
        if (postures == postures[:1]).all():
            postures = postures[:1]
        frames = self._hand.frames(postures.astype(np.float64))
        placed = np.empty((len(postures), len(points), 3), dtype=np.float32)
        for link in np.unique(links):
            frame, of_link = frames[self._names[link]], links == link
            placed[:, of_link] = points[of_link] @ np.moveaxis(frame[:, :3, :3], 1, 2) + frame[:, None, :3, 3]
        return placed

    def lowest(self, up: Floats, postures: NDArray[np.float32]) -> Floats:
        """The least component (n,) [m] along `up` (n, 3) of the hand's convex parts, hand frame.

        Its joints are at `postures` (n, j) [rad or m].
        """
        if (postures == postures[:1]).all():
            postures = postures[:1]
        frames = self._hand.frames(postures.astype(np.float64))
        lowest = np.full(len(up), np.inf)
        for name, corners in self._corners.items():
            frame = frames[name]
            along = np.stack([dot(frame[:, :3, axis], up) for axis in range(3)], axis=-1)
            heights = dot(corners, along[:, None]).min(axis=1) + dot(frame[:, :3, 3], up)
            lowest = np.minimum(lowest, heights)
        return lowest

    def _sample(self) -> tuple[NDArray[np.int64], Floats]:
        """The link (1024,) and place (1024, 3) of each point, link frame [m]."""
        random = np.random.default_rng(0)
        parts = [(i, hull) for i, name in enumerate(self._names) for hull in self._hand.hulls[name]]
        if not parts:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        sizes = np.array([hull.surface.areas.sum() for _, hull in parts])
        counts = np.maximum(1, np.rint(DRAWN_POINTS * sizes / sizes.sum())).astype(np.int64)
        points = [draw_points(hull, count, random) for (_, hull), count in zip(parts, counts, strict=True)]
        links = np.repeat([link for link, _ in parts], counts)
        together = np.concatenate(points)
        frames = np.stack([self._opened[name][0] for name in self._names])[links]
        in_hand = np.einsum("nij,nj->ni", frames[:, :3, :3], together) + frames[:, :3, 3]
        apart = farthest_points(in_hand)
        return links[apart], together[apart]


def draw_points(hull: Hull, n: int, random: np.random.Generator) -> Floats:
    """Draw points (n, 3) [m] that are inside a hull, most of them close under its surface."""
    sizes = hull.surface.areas
    triangles = hull.surface.corners[random.choice(len(sizes), n, p=sizes / sizes.sum())]
    weights = random.dirichlet((1.0, 1.0, 1.0), n)
    centre = hull.surface.corners.reshape(-1, 3).mean(axis=0)
    depth = np.where(random.random(n) < DEEP_SHARE, random.random(n) ** (1 / 3), 1.0) * SURFACE_SCALE
    return np.asarray(centre + depth[:, None] * ((weights[:, :, None] * triangles).sum(axis=1) - centre))


def farthest_points(points: Floats) -> NDArray[np.int64]:
    """Choose at most 1024 of `points` (n, 3): each is the one farthest from those before it.

    Greedy farthest-point sampling (Gonzalez 1985), so that the first points lie wide apart.
    """
    chosen = np.zeros(min(SAMPLE_POINTS, len(points)), dtype=np.int64)
    distances = np.full(len(points), np.inf)
    columns = np.ascontiguousarray(points.T)
    for i in range(1, len(chosen)):
        x, y, z = columns - columns[:, chosen[i - 1], None]
        np.minimum(distances, x * x + y * y + z * z, out=distances)
        chosen[i] = distances.argmax()
    return chosen
