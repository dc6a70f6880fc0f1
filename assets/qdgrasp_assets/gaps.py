"""The air between the bodies of a mesh: which of them meet, and how far it is to those that do not."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.nearness import come_within, nearest
from qdgrasp_assets.rays import SKEW, within
from qdgrasp_assets.solidity import bodies

MEETING = 1e-3
"""Bodies with no more air between them belong together [m]."""
MANY = 2000
"""So many bodies are dust of a scan: they are told apart by the boxes around them alone."""


def apart(mesh: Mesh) -> str:
    """What is said of bodies that are apart; empty where none are."""
    room = gap(mesh)
    if not room:
        return ""
    return (
        f"it is of bodies with about {room:.2g} m of air between them, and an object is one rigid thing: "
        "give each a file of its own, or say with --glued that they are moved as one"
    )


def gap(mesh: Mesh) -> float:
    """The air [m] between bodies that are apart: from the first, and all that hang on it, to the others.

    It may be a little less; 0 where all bodies meet. Two do where their surfaces come near each other, or
    one is in the material of the other, as a hollow is.
    """
    labels = bodies(mesh)
    if not labels.any():
        return 0.0
    is_near = Bodies.of(mesh, labels).reached[labels]
    return 0.0 if is_near.all() else nearest(mesh.corners[is_near], mesh.corners[~is_near])


@dataclass(frozen=True)
class Bodies:
    """The bodies of a mesh."""

    parts: tuple[Floats, ...]
    """The triangles (n, 3, 3) of each [m]."""
    volumes: Floats
    """(b,) [m3]; negative of hollows."""

    @classmethod
    def of(cls, mesh: Mesh, labels: NDArray[np.int64]) -> "Bodies":
        """Those of a mesh whose triangles are labelled (f,) with the body that each is part of."""
        ends = np.cumsum(np.bincount(labels))[:-1]
        parts = np.split(mesh.corners[np.argsort(labels, kind="stable")], ends)
        return cls(tuple(parts), np.bincount(labels, weights=mesh.cone_volumes).astype(np.float64))

    @property
    def reached(self) -> NDArray[np.bool_]:
        """(b,): which bodies hang together with the first one."""
        low, high = self._boxes
        reached: NDArray[np.bool_] = np.arange(len(low)) == 0
        waiting = [0]
        while waiting:
            body = waiting.pop()
            near = np.linalg.norm(_room(low, high, low[body], high[body]), axis=1) <= MEETING
            found = [int(other) for other in np.flatnonzero(near & ~reached) if self._meet(body, int(other))]
            reached[found] = True
            waiting += found
        return reached

    def _meet(self, body: int, other: int) -> bool:
        """Whether two bodies, whose boxes do, meet."""
        if len(self.parts) > MANY or self._holders[body] == other or self._holders[other] == body:
            return True
        first, second = self._toward(body, other), self._toward(other, body)
        return bool(len(first) and len(second)) and come_within(first, second, MEETING)

    def _toward(self, body: int, other: int) -> Floats:
        """The triangles of a body that are near enough to the box of another one to meet that."""
        low, high = self._boxes
        part = self.parts[body]
        room = _room(part.min(axis=1), part.max(axis=1), low[other], high[other])
        near: Floats = part[np.linalg.norm(room, axis=1) <= MEETING]
        return near

    @cached_property
    def _boxes(self) -> tuple[Floats, Floats]:
        """The lowest and the highest corner (b, 3) [m] of the box around each body."""
        low = np.array([part.min(axis=(0, 1)) for part in self.parts])
        return low, np.array([part.max(axis=(0, 1)) for part in self.parts])

    @cached_property
    def _holders(self) -> NDArray[np.int64]:
        """(b,): the innermost body in whose material each one begins; the body itself where it is in none."""
        low, high = self._boxes
        points = np.array([part[0].mean(axis=0) for part in self.parts])
        times, holders = np.zeros(len(points), dtype=np.int64), np.arange(len(points))
        sizes = np.full(len(points), np.inf)
        for body, part in enumerate(self.parts):
            is_held = np.all((low[body] < points) & (points < high[body]), axis=1)
            is_held[body] = False
            held = np.flatnonzero(is_held)
            if len(held):
                found = within(_mesh(part), points[held], np.tile(SKEW, (len(held), 1)))
                times[held] += found
                inner = held[(found > 0) & (abs(self.volumes[body]) < sizes[held])]
                holders[inner], sizes[inner] = body, abs(self.volumes[body])
        return np.where(times > 0, holders, np.arange(len(points)))


def _mesh(part: Floats) -> Mesh:
    return Mesh(part.reshape(-1, 3), np.arange(3 * len(part)).reshape(-1, 3))


def _room(low: Floats, high: Floats, lowest: Floats, highest: Floats) -> Floats:
    """(n, 3) [m]: how far boxes are from another one along each axis; 0 where they are beside each other."""
    room: Floats = np.maximum(low - highest, lowest - high).clip(min=0.0)
    return room
