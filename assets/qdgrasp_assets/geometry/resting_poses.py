"""Resting poses: how an object comes to rest on a table, and how likely each way is.

Goldberg et al. 1999, "Part pose statistics: estimators and experiments": an object that is dropped, turned
in any way, lands on a face of its convex hull with a probability that is the face's solid angle about the
centre of mass. If its centre of mass is not above that face, it topples over the edge beyond which that lies,
to the next face, until it rests. `trimesh.poses` computes the same, in an order that depends on rounding.
"""

from functools import lru_cache

import numpy as np

from qdgrasp_assets.geometry.mesh import join, parse_parts
from qdgrasp_assets.geometry.rotation import Floats, dot
from qdgrasp_assets.scene import RestingPose, Vector
from qdgrasp_protocol.errors import AssetError, ImpossibleValue
from qdgrasp_protocol.spec import ANY_RESTING_POSE

LEAST_PROBABILITY = 0.01
"""Resting poses that are less likely are left out, except the likeliest of all."""
SAME_FACE = np.cos(np.radians(2.0))
"""Cosine of the angle up to which two faces are one: parts of a decomposition meet at small angles."""
ON_EDGE = 1e-7  # Distance beyond an edge at which a centre of mass is still above its face [m]
DECIMALS = 6  # Of directions, heights [m] and probabilities: rounded so, they are the same on every processor
TIED = 3  # Decimals in which probabilities and directions are compared to be put in order


@lru_cache(maxsize=16)
def resting_poses(collision: bytes) -> tuple[RestingPose, ...]:
    """Return the resting poses of an object, the likeliest first, ties by upward direction.

    `collision` are its convex parts as one OBJ text, CoM frame, as they lie on a table in the simulator. Of
    equally likely ones the first is that in which the mesh stands as it was modelled, z up. Raises AssetError
    if the centre of mass is not inside their hull.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import, and few commands need it

    corners = join(parse_parts(collision.decode())).vertices
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        raise AssetError("The object is flat, so that it has no resting pose on a table.") from None
    normals, distances = hull.equations[:, :3], -hull.equations[:, 3]
    if (distances <= 0.0).any():
        raise AssetError("The object has no resting pose on a table: its centre of mass is not inside it.")
    triangles = corners[hull.simplices]
    falls = solid_angles(triangles) / (4.0 * np.pi)
    follow = topples(triangles, normals, distances)
    for face in np.argsort(-distances, kind="stable"):  # an object that topples comes to lie lower
        if follow[face] != face:
            falls[follow[face]] += falls[face]
            falls[face] = 0.0
    found = [
        RestingPose(
            up=up,
            height=round(float(dot(corners, np.array(up)).min()), DECIMALS),
            probability=round(share, DECIMALS),
        )
        for up, share in merged(normals, falls)
    ]
    found.sort(key=lambda pose: [-round(value, TIED) for value in (pose.probability, *reversed(pose.up))])
    return tuple(pose for pose in found if pose.probability >= LEAST_PROBABILITY) or tuple(found[:1])


def chosen_resting_poses(collision: bytes, number: int | str | None, name: str) -> dict[int, RestingPose]:
    """Return the resting poses by number that a number, "any" or None stands for.

    None: none. `collision` are the object's convex parts as one OBJ text. Raises ImpossibleValue if it has no
    pose of that number, where `name` is the object's in a command.
    """
    if number is None:
        return {}
    poses = resting_poses(collision)
    if number == ANY_RESTING_POSE:
        return dict(enumerate(poses))
    if not isinstance(number, int) or not 0 <= number < len(poses):
        known = (
            f"'{ANY_RESTING_POSE}' or 0 to {len(poses) - 1}, as `qdgrasp asset resting-poses {name}` lists"
        )
        raise ImpossibleValue("resting_pose", number, known)
    return {number: poses[number]}


def solid_angles(triangles: Floats) -> Floats:
    """Return the solid angles (t,) [sr] of triangles (t, 3, 3) about the origin.

    Van Oosterom and Strackee 1983, "The solid angle of a plane triangle".
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    volumes = np.abs(dot(a, np.cross(b, c)))
    p, q, r = (np.sqrt(dot(each, each)) for each in (a, b, c))
    return np.asarray(2.0 * np.arctan2(volumes, p * q * r + dot(a, b) * r + dot(a, c) * q + dot(b, c) * p))


def topples(triangles: Floats, normals: Floats, distances: Floats) -> list[int]:
    """Return the face that an object topples to from each face; itself where it rests.

    The centre of mass is the origin, `distances` (t,) [m] are those of the faces' planes. An object topples
    over the edge that is met on the way from the middle of the face to the foot of the centre of mass.
    """
    follow = []
    for face, (normal, distance) in enumerate(zip(normals, distances, strict=True)):
        foot, middle = distance * normal, triangles[face].mean(axis=0)
        beyond = dot(normals, foot) - distances
        way = dot(normals, foot - middle)
        is_behind = (beyond > ON_EDGE) & (way > 0.0)
        met = np.full(len(normals), np.inf)
        met[is_behind] = ((distances - dot(normals, middle)) / np.where(is_behind, way, 1.0))[is_behind]
        follow.append(int(met.argmin()) if is_behind.any() else face)
    return follow


def merged(normals: Floats, shares: Floats) -> list[tuple[Vector, float]]:
    """Return the upward directions of an object at rest on its faces, with probabilities.

    Faces of nearly the same normal are one, which has the normal of the likeliest of them.
    """
    found: list[tuple[Vector, float]] = []
    waiting = np.array(
        sorted(np.flatnonzero(shares), key=lambda face: -round(float(shares[face]), DECIMALS)), np.intp
    )
    while len(waiting):
        normal = normals[waiting[0]]
        is_same = dot(normals[waiting], normal) >= SAME_FACE
        x, y, z = (0.0 - normal.round(DECIMALS)).tolist()
        found.append(((x, y, z), float(shares[waiting[is_same]].sum())))
        waiting = waiting[~is_same]
    return found
