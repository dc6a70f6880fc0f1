"""The objects of the benchmark that neither the catalog nor the asset path has.

They are parametric and closed, without random numbers, in coordinates of whole micrometres, so that their
files have the same bits everywhere. The benchmark names a file as `grasp-bench-1/vase.stl`.
"""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import write_whole
from qdgrasp_assets.geometry.mesh import Floats, Mesh, join
from qdgrasp_protocol.errors import InputError

NAME = "grasp-bench-1"
"""Name and version of the benchmark: its folder, and the beginning of its campaigns' names."""
SIDES = 24  # Corners of a turned solid
MILLIMETRE = 1e-3
DIGEST_DIGITS = 16

Faces = NDArray[np.int64]
"""(f, 3)."""
Profile = Iterable[tuple[float, float]]
"""Radius and height [mm]."""
Point = tuple[float, float, float]
"""[mm]."""


def revolve(profile: Floats, sides: int) -> Floats:
    """Return the profile at each corner (p, sides, 3) [m]; facet k is from corner k to k + 1.

    `profile` is (p, 2) [m]: radius and height. Facet 0 faces x.
    """
    angles = (np.arange(sides) - 0.5) * 2 * np.pi / sides
    radius, height = profile.T[:, :, None]
    return np.stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.broadcast_to(height, (len(profile), sides))],
        axis=-1,
    )


def cup(profile: Floats, sides: int) -> Mesh:
    """Return the closed surface of a profile from the outer bottom to the inner floor."""
    corners = revolve(profile, sides).reshape(-1, 3)
    centres = np.array([(0.0, 0.0, profile[0, 1]), (0.0, 0.0, profile[-1, 1])])
    rings = np.arange(len(corners)).reshape(-1, sides)
    below, above = len(corners), len(corners) + 1
    faces = [fan(below, rings[0][::-1]), strip(rings), fan(above, rings[-1])]
    return Mesh(np.concatenate([corners, centres]), np.concatenate(faces))


def fan(centre: int, ring: Faces) -> Faces:
    """Return triangles from a centre to neighbours of a vertex ring (s,), counter-clockwise."""
    return np.stack([np.full(len(ring), centre), ring, np.roll(ring, -1)], axis=1)


def strip(rings: Faces) -> Faces:
    """Return two triangles for each quadrilateral between rings (r, s) of vertices."""
    here, there = rings[:-1], rings[1:]
    right, far = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    quads = np.stack([here, right, far, here, far, there], axis=-1)
    return quads.reshape(-1, 3)


def turned(*profile: tuple[float, float], sides: int = SIDES) -> Mesh:
    """Return the solid of revolution of a profile, from its bottom's middle to its top's."""
    return cup(np.array(profile), sides)


def loop(outline: Profile, sides: int) -> Mesh:
    """Return the ring that a closed outline makes when turned about the axis."""
    rings = revolve(np.array([*outline]), sides)
    corners = np.arange(rings.shape[0] * sides).reshape(-1, sides)
    return Mesh(rings.reshape(-1, 3), strip(np.concatenate([corners, corners[:1]])))


def bar(sections: Iterable[Floats]) -> Mesh:
    """Return the solid between convex sections (s, 3) [mm] in their order, with both ends.

    Seen from the last one the corners of each are counter-clockwise.
    """
    rings = np.stack([*sections])
    count, sides, _ = rings.shape
    corners = np.arange(count * sides).reshape(count, sides)
    first, last = (
        [(ring[0], *pair) for pair in pairwise(ring[1:])] for ring in (corners[0, ::-1], corners[-1])
    )
    return Mesh(rings.reshape(-1, 3), np.concatenate([first, strip(corners), last]))


def block(sides: Point, centre: Point) -> Mesh:
    """Return a box of these sides around a centre."""
    x, y, z = np.array(sides) / 2
    corners = ((-x, -y), (x, -y), (x, y), (-x, y))
    return bar(np.array([(*corner, height) for corner in corners]) + centre for height in (-z, z))


def ball(radius: float, centre: Point) -> Mesh:
    """Return a sphere of six belts and two flat poles of 0.26 radii."""
    angles = np.radians(np.linspace(-75, 75, 6))
    return cup(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1), 12).moved(centre)


def vase() -> Mesh:
    """Hollow, with a belly of 84 mm, a neck of 40 mm and walls of 4 mm."""
    outside = ((30, 0), (42, 45), (34, 80), (20, 110), (27, 135))
    inside = ((23, 135), (16, 110), (30, 80), (38, 45), (26, 5))
    return turned(*outside, *inside)


def bottle() -> Mesh:
    """Full and closed, 68 mm across, with a neck of 26 mm and a cap."""
    return turned((34, 0), (34, 125), (13, 165), (13, 190), (15, 190.5), (15, 206))


def knob() -> Mesh:
    """A handle of a drawer: a foot of 16 mm and a head of 44 mm."""
    return turned((8, 0), (8, 18), (12, 22), (20, 28), (22, 36), (20, 44), (12, 49), (4, 50))


def pipe() -> Mesh:
    """Open at both ends, 50 mm across, with walls of 6 mm."""
    return loop(((25, 0), (25, 120), (19, 120), (19, 0)), SIDES)


def hammer() -> Mesh:
    """A round handle of 230 mm, and a head of 100 mm across it."""
    handle = turned((11, 0), (13, 4), (12, 225))
    return join([handle, block((30, 100, 30), (0, 5, 230))])


def screwdriver() -> Mesh:
    """An octagonal handle of 30 mm and a shaft of 6 mm, 200 mm long."""
    return turned((10, 0), (15, 8), (15, 90), (9, 105), (3, 106), (3, 195), (1, 200), sides=8)


def wrench() -> Mesh:
    """Flat, with an open jaw of 22 mm and a ring of 15 mm, 164 mm long and 8 mm thick."""
    angles = np.radians(np.linspace(35, 325, 13))  # of the jaw, which is open along x

    def section(angle: float) -> Floats:
        corners = ((11, -4), (11, 4), (20, 4), (20, -4))
        return np.array([(r * np.cos(angle), r * np.sin(angle), z) for r, z in corners])

    ring = loop(((14, -4), (14, 4), (7.5, 4), (7.5, -4)), 24).moved((-134, 0, 0))
    return join([bar(map(section, angles)), block((109, 14, 7), (-71, 0, 0)), ring])


def plate() -> Mesh:
    """160 mm by 110 mm, 3 mm thick."""
    return block((160, 110, 3), (0, 0, 0))


def bracket() -> Mesh:
    """An angle of two legs, 80 mm and 60 mm long, 50 mm wide and 4 mm thick."""
    cuts = (((0, 60), (4, 60)), ((0, 0), (4, 4)), ((80, 0), (80, 4)))
    return bar(np.array([(*outer, -25), (*inner, -25), (*inner, 25), (*outer, 25)]) for outer, inner in cuts)


def ring() -> Mesh:
    """A torus of 108 mm, 18 mm thick."""
    angles = np.radians(np.arange(16) * 22.5)
    return loop(zip(45 + 9 * np.cos(angles), 9 * np.sin(angles), strict=True), 48)


def heap() -> Mesh:
    """Two boxes that stand on a third one."""
    return join(
        block(sides, centre)
        for sides, centre in (
            ((80, 60, 30), (0, 0, 15)),
            ((40, 54, 24), (-18, 0, 42)),
            ((24, 30, 30), (20, -6, 45)),
        )
    )


def bunch() -> Mesh:
    """Five balls of 34 to 44 mm that stick together, as grapes do."""
    balls = ((22, (0, 0, 0)), (19, (37, 0, 0)), (18, (-36, 0, 0)), (20, (0, 39, 0)), (17, (0, 0, 36)))
    return join(ball(*one) for one in balls)


@dataclass(frozen=True)
class BenchmarkObject:
    """An object that is made here."""

    build: Callable[[], Mesh]
    """Makes its mesh [mm]."""
    mass: float
    """[kg]; the campaigns say the same."""
    sha256: str
    """The beginning of the digest of its file."""

    @property
    def file(self) -> bytes:
        """Its binary STL file [m], with normals of length 0, which readers compute."""
        mesh = self.build()
        corners = np.round(mesh.corners * MILLIMETRE, 6) + 0.0  # 0.0: no negative zeros
        triangles = np.zeros(
            len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
        )
        triangles["corners"] = corners
        head = f"qdgrasp, benchmark {NAME}: {self.build.__name__}".encode().ljust(80)
        return head + len(triangles).to_bytes(4, "little") + triangles.tobytes()


OBJECTS = {
    made.build.__name__: made
    for made in (
        BenchmarkObject(vase, 0.28, "bb0f3e196eadfbaa"),
        BenchmarkObject(bottle, 0.55, "24cec07cc822dcfd"),
        BenchmarkObject(knob, 0.03, "b75b62bc5bb12aa6"),
        BenchmarkObject(pipe, 0.14, "a39035166c7d8d9c"),
        BenchmarkObject(hammer, 0.5, "e46f93764ff37dab"),
        BenchmarkObject(screwdriver, 0.09, "181bf566273b6eed"),
        BenchmarkObject(wrench, 0.15, "f70ff9713c43695d"),
        BenchmarkObject(plate, 0.065, "3f969af3d6b55741"),
        BenchmarkObject(bracket, 0.075, "9d667af4281b92f9"),
        BenchmarkObject(ring, 0.085, "12d1393f09041fee"),
        BenchmarkObject(heap, 0.12, "4a354e3d4ffcf4ca"),
        BenchmarkObject(bunch, 0.13, "7b22322a89fe8101"),
    )
}


def make_asset(path: Path) -> None:
    """Write the file of an object made here; InputError if its content is not the benchmark's."""
    made = OBJECTS[path.stem]
    content = made.file
    if (found := hashlib.sha256(content).hexdigest()[:DIGEST_DIGITS]) != made.sha256:
        raise InputError(
            f"{path} comes out otherwise here than in the benchmark (digest {found}, not {made.sha256}); "
            "take the file from a machine where it does not."
        )
    write_whole(path, content)
