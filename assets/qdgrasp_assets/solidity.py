"""Whether a mesh encloses a space: all that is wrong with it, in words."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.units import LARGEST, SMALLEST, advice

FLATTEST = 1e-12
"""A closed mesh with less volume has no inside [m3]."""
MOST = 500_000
"""Triangles of an object, at most: they travel to every worker, and are looked at one by one."""

Numbers = NDArray[np.int64]


def faults(mesh: Mesh) -> tuple[str, ...]:
    """All that is wrong with a mesh as a surface in metres; empty when nothing is."""
    if not np.isfinite(mesh.vertices).all():
        return ("it has vertices that are not finite",)
    if len(mesh.faces) > MOST:
        return (
            f"it has {len(mesh.faces)} triangles, and at most {MOST} are taken: simplify it, for example to "
            "20 000 (quadric edge collapse decimation in MeshLab)",
        )
    edges = Edges(mesh)
    checks = (_of_no_hands_size(mesh), _open(edges), _wound(edges), _without_inside(mesh, edges))
    return tuple(found for found in checks if found)


@dataclass(frozen=True)
class Edges:
    """The edges of a mesh, and how many triangles each has."""

    mesh: Mesh

    @cached_property
    def directed(self) -> Numbers:
        """(3 f, 2): each triangle's edges, in its direction; those of triangle i are i, f + i, 2 f + i."""
        faces = self.mesh.faces
        return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])

    @cached_property
    def which(self) -> Numbers:
        """(3 f,): the number of each directed edge without its direction."""
        low, high = self.directed.min(axis=1), self.directed.max(axis=1)
        _, which = np.unique(low * len(self.mesh.vertices) + high, return_inverse=True)
        return which.reshape(-1)

    @cached_property
    def times(self) -> Numbers:
        """(e,): how many triangles each edge has."""
        return np.bincount(self.which)

    @property
    def is_closed(self) -> bool:
        """Whether every edge has an even number of triangles."""
        return not (self.times % 2).any()

    @cached_property
    def is_wound_alike(self) -> bool:
        """Whether as many triangles run along each edge in one direction as in the other."""
        return not self._leans.any()

    @cached_property
    def _leans(self) -> Numbers:
        """(e,): how many more triangles run along each edge upward than downward."""
        upward = np.where(self.directed[:, 0] < self.directed[:, 1], 1, -1)
        return np.bincount(self.which, weights=upward).astype(np.int64)

    @property
    def torn(self) -> int:
        """How many edges of a closed mesh have neighbours that are wound both ways."""
        return int((self._leans != 0).sum())

    @cached_property
    def loose(self) -> Numbers:
        """(k, 2): edges with one triangle only, in its direction."""
        loose: Numbers = self.directed[self.times[self.which] == 1]
        return loose

    @cached_property
    def holes(self) -> tuple[Numbers, ...]:
        """The loose edges (k, 2) around each hole, the widest first."""
        if not len(self.loose):
            return ()
        labels = _connected(self.loose, len(self.mesh.vertices))[self.loose[:, 0]]
        found = [self.loose[labels == label] for label in np.unique(labels)]
        return tuple(sorted(found, key=lambda hole: -width(self.mesh, hole)))


def width(mesh: Mesh, edges: Numbers) -> float:
    """The largest side of the bounding box of edges (k, 2) [m]."""
    return float(np.ptp(mesh.vertices[edges.reshape(-1)], axis=0).max())


def middle(mesh: Mesh, edges: Numbers) -> Floats:
    """(3,) [m]: the middle of that box."""
    points = mesh.vertices[edges.reshape(-1)]
    centre: Floats = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre


def bodies(mesh: Mesh) -> Numbers:
    """(f,): the body that each triangle is part of, numbered from 0; triangles of one share vertices."""
    faces = mesh.faces
    labels = _connected(np.concatenate([faces[:, :2], faces[:, 1:]]), len(mesh.vertices))
    _, numbers = np.unique(labels[faces[:, 0]], return_inverse=True)
    return numbers.reshape(-1)


def body_volumes(mesh: Mesh) -> Floats:
    """(b,) [m3]: the volume of each body; negative of one that is inside out, such as a hollow."""
    return np.bincount(bodies(mesh), weights=mesh.cone_volumes).astype(np.float64)


def _connected(pairs: Numbers, count: int) -> Numbers:
    """(count,): the connected component of each vertex, joined by pairs (k, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: Numbers = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def place(point: Floats) -> str:
    """A point (3,) [m] in words."""
    return "(" + ", ".join(f"{number:.4f}" for number in point) + ")"


def _of_no_hands_size(mesh: Mesh) -> str:
    largest = float(mesh.extents.max())
    if SMALLEST <= largest <= LARGEST:
        return ""
    size = " x ".join(f"{side:.4g}" for side in mesh.extents)
    kind = "larger" if largest > LARGEST else "smaller"
    return f"it is {size} m large, {kind} than what a hand grasps; {advice(largest)}"


def _open(edges: Edges) -> str:
    loose, holes = len(edges.loose), edges.holes
    if loose:
        around = "1 hole" if len(holes) == 1 else f"{len(holes)} holes, the largest"
        where = place(middle(edges.mesh, holes[0]))
        return (
            f"it is not closed (watertight): {loose} edges have only one triangle, around {around} "
            f"{width(edges.mesh, holes[0]):.4f} m wide at {where}; close it in the program that drew it, or "
            "have small holes filled with `qdgrasp object check FILE --fill-holes --repaired NEW`"
        )
    odd = np.flatnonzero(edges.times % 2)
    if len(odd):
        where = place(middle(edges.mesh, edges.directed[edges.which == odd[0]]))
        return (
            f"it is not closed (watertight): {len(odd)} edges have an odd number of triangles, one at "
            f"{where}; take out the sheets that stand in it"
        )
    return ""


def _wound(edges: Edges) -> str:
    if not edges.is_closed or edges.is_wound_alike:
        return ""
    return (
        f"its triangles are wound both ways along {edges.torn} edges, and cannot all face outward: it has no "
        "inside, like a Klein bottle; draw it again"
    )


def _without_inside(mesh: Mesh, edges: Edges) -> str:
    if abs(mesh.volume) < FLATTEST and edges.is_closed:
        return "it is flat: it encloses no volume; give it a thickness"
    return ""
