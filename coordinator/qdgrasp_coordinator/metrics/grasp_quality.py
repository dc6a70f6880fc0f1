"""Settled pose, motion of the object and margin of recorded grasps, and limits to them.

Rows are those of a journal or of success pages. Where no settled pose was recorded, motion and margin are
NaN, which no limit admits.
"""

from dataclasses import dataclass, fields
from typing import cast

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.geometry.rotation import Floats, conjugate, dot, rotate, tangents
from qdgrasp_assets.scene import Scene, SceneObject
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import CONTACT_VALUES, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import counted

MM = 1e-3
TORSION = 0.005  # Of finger and object [m]: the radius of a fingertip's patch, as `physical` takes it


def settled_mask(rows: Rows) -> NDArray[np.bool_]:
    """(n,): True where the settled pose is recorded."""
    return np.asarray(rows["settled"].any(axis=1))


def settled_poses(rows: Rows) -> Floats:
    """(n, 7): the hand's base link after closing, CoM frame; as commanded where unknown."""
    poses, known = rows["base_to_object"].astype(np.float64), settled_mask(rows)
    if known.any():  # rows without contacts have no room for it
        poses[known] = rows["settled"][known]
    return poses


def object_motion(rows: Rows) -> Floats:
    """(n, 2): how far the object moved in the hand while it closed [m], and turned [rad].

    The way of its centre of mass, in the hand's frame. NaN where it is not known.
    """
    before, after = rows["base_to_object"].astype(np.float64), settled_poses(rows)
    first, last = (rotate(conjugate(poses[:, 3:]), -poses[:, :3]) for poses in (before, after))
    cosines = np.abs((before[:, 3:] * after[:, 3:]).sum(axis=1)).clip(0.0, 1.0)
    moved = np.column_stack([np.sqrt(dot(last - first, last - first)), 2.0 * np.arccos(cosines)])
    return np.where(settled_mask(rows)[:, None], moved, np.nan)


def contact_values(rows: Rows) -> Floats:
    """(n, k, 7): point [m], normal into the object and force [N] of each contact, CoM frame."""
    slots = rows.dtype["contact_links"].shape[0]
    values: Floats = rows["contact_points"].astype(np.float64).reshape(len(rows), slots, CONTACT_VALUES)
    return values


def recorded_margins(rows: Rows, body: SceneObject) -> Floats:
    """(n,): the Ferrari-Canny margin of contacts (`grasp_margins`); NaN: none were recorded."""
    known, found = settled_mask(rows), np.full(len(rows), np.nan)
    if known.any():
        values = contact_values(rows)
        found[known] = grasp_margins(
            values[known, :, :3],
            values[known, :, 3:6],
            rows["contact_links"][known] > 0,
            friction=body.lateral_friction,
            torsion=TORSION,
            radius=body.radius,
        )
    return found


def takes_held(spec: RunSpec, min_fitness: float | None = None) -> bool:
    """Return whether grasps that hold are taken: by default if `physical` judges a pose."""
    return min_fitness is None and spec.nominal_protocol == "physical"


def taken_mask(rows: Rows, spec: RunSpec, min_fitness: float | None) -> NDArray[np.bool_]:
    """(n,): True for rows of the least fitness that is asked for, or more.

    None: where `takes_held` those whose outcome is `HELD`, elsewhere those of fitness 1 or more.
    """
    if takes_held(spec, min_fitness):
        return np.asarray(rows["outcome"] == Outcome.HELD)
    return np.asarray(rows["fitness"] >= (1 if min_fitness is None else min_fitness))


@dataclass(frozen=True)
class GraspLimits:
    """Limits to what closing did; None: no limit. Raises ImpossibleValue for a negative one."""

    max_penetration: float | None = None
    """[mm]."""
    max_motion: float | None = None
    """Of the object in the hand [mm]."""
    min_margin: float | None = None
    min_links: int | None = None
    """Finger links that touch."""

    def __post_init__(self) -> None:
        for name, value in self.given.items():
            if not 0 <= value < np.inf:
                raise ImpossibleValue(name, value, "a number not less than 0")

    @property
    def given(self) -> dict[str, float]:
        """The limits that there are, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    def admitted(self, rows: Rows, scene: Scene) -> NDArray[np.bool_]:
        """(n,): True for rows within all limits; margins are computed last, for the others' rows."""
        mask = np.ones(len(rows), dtype=bool)
        if self.max_penetration is not None:
            mask &= rows["penetration"] <= self.max_penetration * MM
        if self.max_motion is not None:
            mask &= object_motion(rows)[:, 0] <= self.max_motion * MM
        if self.min_links is not None:
            mask &= rows["contacts"] >= self.min_links
        if self.min_margin is not None:
            mask[mask] = recorded_margins(rows[mask], scene.object) >= self.min_margin
        return mask

    def reason(self, rows: Rows, scene: Scene) -> str:
        """Say how many of some rows each limit admits, for a person."""
        alone = {name: msgspec.convert({name: value}, GraspLimits) for name, value in self.given.items()}
        counts = {name: int(limit.admitted(rows, scene).sum()) for name, limit in alone.items()}
        words = (f"--{name.replace('_', '-')} {self.given[name]:g} admits {n}" for name, n in counts.items())
        return f"of {counted(len(rows), 'grasp')} {', '.join(words)}"


NO_LIMITS = GraspLimits()


# The Ferrari-Canny margin: the least wrench that a grasp's contacts cannot balance.
#
# Ferrari and Canny 1992, "Planning optimal grasps", the measure Q1. A contact that pushes with a normal force
# of 1 can give any wrench in the convex hull of its primitive wrenches; contacts whose normal forces sum to
# at most 1 can give any in the hull of all of them. The margin is the radius of the largest ball about the
# origin in that hull: an external wrench of this size, in units of the summed normal force and whatever its
# direction, is balanced, and one that is any larger is not, in the worst direction. A torque counts by its
# value over the object's radius, so that the margin has no unit and is the same for an object of any size.
#
# The friction cone is replaced by a pyramid inside it, so the margin is a lower bound: it is never above that
# of the round cone, and never below that of a cone with friction * cos(pi / edges), 0.924 of it for 8 edges.
# With torsional friction a contact also gives its normal force with a torque about its normal; between these
# and the edges of the pyramid lies a hull inside the ellipsoid of a soft finger (Howe and Cutkosky 1996,
# "Practical force-motion models for sliding manipulation").

CONE_EDGES = 8
"""Edges of the pyramid that stands for a friction cone."""
LEAST = 1e-6
"""Smallest margin that is told from 0; float32 places a contact to about 1e-7 of the object's radius."""
TOLERANCE = 1e-9
"""By how much a margin may be above that of the pyramids; float32 rounds a margin of 0.1 by 4e-9."""
_DIMENSIONS = 6
_FACETS_IN_ROUND = 16  # Of 8, 16 and growing numbers, 16 took least in the slowest grasps


def grasp_margins(
    points: ArrayLike,
    normals: ArrayLike,
    touching: NDArray[np.bool_],
    *,
    friction: float,
    radius: float,
    torsion: float = 0.0,
    edges: int = CONE_EDGES,
) -> NDArray[np.float32]:
    """Return the margin (n,) of each grasp; 0 where some wrench cannot be balanced at all.

    Parameters
    ----------
    points
        (n, k, 3): contact points [m], object's centre-of-mass frame.
    normals
        (n, k, 3): unit normals of the object's surface, into the object, the direction in which a finger
        pushes.
    touching
        (n, k): the places of `points` and `normals` that hold a contact; others are not read.
    friction
        Coefficient of Coulomb friction.
    radius
        Greatest distance of a vertex of the object from its centre of mass [m], greater than 0.
    torsion
        Coefficient of torsional friction [m]: greatest torque about the normal over the normal force; 0 for
        point contacts.
    edges
        Edges of a friction cone's pyramid, 3 or more; the first leans towards the first tangent of the normal
        (`geometry.rotation.tangents`).

    Notes
    -----
    One input gives the same bits each time on one machine. Margins of at most `LEAST` are given as 0.
    """
    counts = touching.sum(axis=1)
    points, normals = (np.asarray(each, dtype=np.float64)[touching] for each in (points, normals))
    wrenches = primitive_wrenches(points, normals, friction, radius, torsion, edges)
    grasps = np.split(wrenches, np.cumsum(counts))[:-1]
    return np.array([ball_radius(grasp.reshape(-1, _DIMENSIONS)) for grasp in grasps], dtype=np.float32)


def primitive_wrenches(
    points: Floats, normals: Floats, friction: float, radius: float, torsion: float, edges: int
) -> Floats:
    """Return the primitive wrenches (c, e, 6) of contacts: force, torque over radius.

    Points and normals are (c, 3), as for `grasp_margins`. e is `edges`, and two more with torsional friction;
    the normal force of each is 1.
    """
    angles = 2 * np.pi * np.arange(edges)[:, None] / edges
    first, second = (tangent[:, None] for tangent in tangents(normals))
    pushes, arms = normals[:, None], points[:, None]
    forces = pushes + friction * (np.cos(angles) * first + np.sin(angles) * second)
    torques = np.cross(arms, forces)
    if torsion:
        forces = np.concatenate([forces, pushes, pushes], axis=1)
        about = np.cross(arms, pushes)
        torques = np.concatenate([torques, about - torsion * pushes, about + torsion * pushes], axis=1)
    return np.concatenate([forces, torques / radius], axis=2)


def ball_radius(wrenches: Floats) -> float:
    """Return the radius of the largest ball about 0 in the convex hull of wrenches (m, 6), or 0.

    The hull of 128 wrenches has some 10 000 facets, and the nearest alone is asked for. So a hull of few
    wrenches grows where it is nearest to the origin (Zheng 2013, "An efficient algorithm for a grasp quality
    measure"): the wrenches that reach farthest along the normals of its nearest facets join it, until the
    nearest facet is one that no wrench lies beyond. For any unit vector the farthest wrench along it is an
    upper bound of the radius, and so the distance that is returned is one too; the hull of the chosen
    wrenches lies within that of all, so its nearest facet is a lower bound.

    A hull that is flat is told beforehand. In a QR decomposition with pivoting the wrenches lie no farther
    from a hyperplane than the last diagonal element, and the radius is no greater. Otherwise the pivots are
    the corners of a simplex to begin from.

    Qhull moves the wrenches by about 1e-10 (option QJ), always in the same way: the edges of a pyramid lie in
    one plane, and merging the facets of such wrenches is twice as slow and may fail.
    """
    from scipy.linalg import qr  # scipy takes its time
    from scipy.spatial import ConvexHull

    if len(wrenches) <= _DIMENSIONS:
        return 0.0
    triangle, pivots = qr((wrenches - wrenches[0]).T, mode="r", pivoting=True)
    if abs(triangle[_DIMENSIONS - 1, _DIMENSIONS - 1]) <= LEAST:
        return 0.0
    chosen = np.zeros(len(wrenches), dtype=np.bool_)
    chosen[[0, *pivots[:_DIMENSIONS]]] = True
    smallest = np.inf
    while True:
        facets = cast(Floats, ConvexHull(wrenches[chosen], qhull_options="QJ").equations)
        distances = -facets[:, _DIMENSIONS]
        nearest = np.argsort(distances, kind="stable")[:_FACETS_IN_ROUND]
        along = wrenches @ facets[nearest, :_DIMENSIONS].T
        farthest = along.max(axis=0)
        smallest = min(smallest, float(farthest.min()))
        beyond = along.argmax(axis=0)[farthest > distances[nearest] + TOLERANCE]
        if smallest <= LEAST:
            return 0.0
        if smallest <= distances[nearest[0]] + TOLERANCE or chosen[beyond].all():
            return smallest
        chosen[beyond] = True
