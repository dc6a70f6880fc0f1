"""Inspections: everything that is known of an object of one's own before a run is made of it."""

from collections.abc import Iterator

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.convex import TIME_LIMIT, Tell, collision_parts, quietly
from qdgrasp_assets.findings import Findings
from qdgrasp_assets.gaps import apart
from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.room import Room
from qdgrasp_assets.scans import size
from qdgrasp_assets.scene import Vector
from qdgrasp_assets.solid import Draft
from qdgrasp_assets.solidity import Edges, body_volumes
from qdgrasp_assets.surface import POINTS_PER_METRE
from qdgrasp_assets.units import in_words
from qdgrasp_assets.vectors import vector
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.phrases import counted

WATER = 1000.0
"""[kg/m3]"""
LIGHTEST, HEAVIEST = 20.0, 12_000.0
"""What is grasped is denser than foam, and less dense than lead [kg/m3]."""
ROUNDING = 1e-9
MANY = 100_000
"""With more triangles convex parts take minutes: half as many, as a torus, take CoACD 14 s of one core."""


class Convex(Struct, frozen=True, kw_only=True):
    """The convex parts that stand for an object in the simulator."""

    count: int
    source: str
    """"own hull" or "coacd"."""
    filled: float
    """The share of the surface in front of which they fill the room that a finger has, 0 to 1."""
    bare: float
    """The share of the surface that all of them are behind, 0 to 1."""

    @property
    def words(self) -> str:
        """For a person."""
        return (
            f"{self.count}, {self.source}: fill the room before {100 * self.filled:.1f} % of the surface, "
            f"leave {100 * self.bare:.1f} % of it out"
        )


class Inspection(Findings, frozen=True, kw_only=True):
    """What was found of a mesh file."""

    scale: float
    """Metres to a unit of the file."""
    extents: Vector
    """Sides of the bounding box [m]."""
    triangles: int
    closed: bool
    """Whether every edge has two triangles (or another even number)."""
    bodies: int
    """Which do not touch; they are one rigid object."""
    hollows: int = 0
    """Closed spaces within bodies."""
    volume: float | None = None
    """[m3]; None, as what follows, of a mesh that cannot be used."""
    mass: float | None = None
    """[kg]; None: not said."""
    density: float | None = None
    """[kg/m3]; None without a mass."""
    centre_of_mass: Vector | None = None
    """At uniform density, in the mesh file's frame [m]."""
    inertia: tuple[Vector, Vector, Vector] | None = None
    """At uniform density, about the centre of mass, axes of the mesh [kg m2]; None without a mass."""
    surface_points: int | None = None
    """How many points of the surface an evaluation under `paper` knows."""
    convex: Convex | None = None
    """None also where they were not asked for."""
    repairs: tuple[str, ...] = ()
    """What was done to the mesh before all this was measured."""

    @property
    def facts(self) -> tuple[str, ...]:
        """The most of it, in a few words each."""
        volume = () if self.volume is None else (f"{self.volume * 1e6:.2f} cm3",)
        repairs = (f"repaired: {'; '.join(self.repairs)}",) if self.repairs else ()
        return (f"{size(self.extents)} m", counted(self.triangles, "triangle"), *volume, *repairs)

    def _lines(self) -> Iterator[tuple[str, str]]:
        yield "object", self.name
        yield "size", f"{size(self.extents)} m" + ("" if self.scale == 1 else f" ({in_words(self.scale)})")
        yield "surface", f"{counted(self.triangles, 'triangle')}, {'closed' if self.closed else 'NOT closed'}"
        yield "bodies", f"{self.bodies}" + (f", with {self.hollows} hollow within" if self.hollows else "")
        if self.volume is not None and self.centre_of_mass is not None:
            yield "volume", f"{self.volume * 1e6:.2f} cm3"
            yield "mass", self._mass
            yield "centre of mass", f"{_numbers(self.centre_of_mass)} m, frame of the mesh file"
            for turn, row in enumerate(self.inertia or ()):
                words = "kg m2, about the centre of mass, solid throughout"
                yield "" if turn else "inertia", f"{_small(row)} {'' if turn else words}".rstrip()
            yield "surface points", f"{self.surface_points}"
            yield "convex parts", self.convex.words if self.convex else "not looked for"
        repairs = self.repairs or (() if self.faults else ("nothing had to be",))
        yield from (("repaired", words) for words in repairs)

    @property
    def _mass(self) -> str:
        return "not said" if self.mass is None else f"{self.mass:g} kg, {self.density:.0f} kg/m3"


def inspect(
    draft: Draft,
    name: str,
    *,
    scale: float | None = None,
    mass: float | None = None,
    glued: bool = False,
    parts: bool = True,
    time_limit: float = TIME_LIMIT,
    tell: Tell = quietly,
) -> Inspection:
    """Everything that is known of a mesh file.

    Parameters
    ----------
    name
        How it is called.
    scale
        What it was read with; None: 1.
    mass
        [kg]; None: unknown.
    glued
        Whether bodies that are apart are meant to be one rigid object.
    parts
        Whether its convex parts are found, which takes minutes where they are not kept already.
    time_limit
        How long that may take [s].
    tell
        Hears how far that is.
    """
    mesh, volumes = draft.mesh, body_volumes(draft.mesh)
    hollows = 0 if draft.faults else int((volumes < 0).sum())
    found = Inspection(
        name=name,
        scale=1.0 if scale is None else scale,
        extents=vector(mesh.extents),
        triangles=len(mesh.faces),
        closed=Edges(mesh).is_closed,
        bodies=len(volumes) - hollows,
        hollows=hollows,
        repairs=draft.repairs,
        notes=tuple(_of_file(draft)),
        faults=draft.faults,
    )
    if found.faults:
        return found
    found = _measured(found, mesh, mass)
    if not glued and (fault := apart(mesh)):
        return msgspec.structs.replace(found, notes=(), faults=(fault,))
    return _with_parts(found, mesh, time_limit, tell) if parts else found


def _measured(found: Inspection, mesh: Mesh, mass: float | None) -> Inspection:
    """The same with what only a solid has."""
    density = None if mass is None else mass / mesh.volume
    return msgspec.structs.replace(
        found,
        volume=mesh.volume,
        mass=mass,
        density=density,
        centre_of_mass=vector(_plain(mesh.centre_of_mass)),
        inertia=None if mass is None else tuple(vector(row) for row in _plain(mass * mesh.inertia)),
        surface_points=int(POINTS_PER_METRE * np.linalg.norm(mesh.extents)),
        notes=(*found.notes, *_of_solid(found, mesh), *_of_mass(mesh.volume, density)),
    )


def _with_parts(found: Inspection, mesh: Mesh, time_limit: float, tell: Tell) -> Inspection:
    try:
        source, parts = collision_parts(mesh, found.name, time_limit, tell)
    except AssetError as error:
        return msgspec.structs.replace(found, faults=(str(error).rstrip("."),))
    fit = Room(mesh).fit(parts)
    convex = Convex(count=len(parts), source=source, filled=fit.filled, bare=fit.bare)
    return msgspec.structs.replace(found, convex=convex)


def _of_file(draft: Draft) -> Iterator[str]:
    if draft.geometries > 1:
        yield f"the file holds {draft.geometries} geometries, which are taken as one object"


def _of_solid(found: Inspection, mesh: Mesh) -> Iterator[str]:
    if found.bodies > 1:
        yield (
            f"its {found.bodies} bodies are moved as one rigid object, as if they were glued: give things "
            "that move by themselves files of their own"
        )
    if found.hollows:
        yield "a hollow is aimed at, and no finger reaches it: leave it out unless it matters for the balance"
    inside = Room(mesh).inside
    if inside:
        yield (
            f"{100 * inside:.1f} % of its surface lies inside it, where it cuts itself or bodies overlap: "
            "such room counts twice in volume and centre of mass, and is aimed at; unite the bodies"
        )
    if found.triangles > MANY:
        yield f"{found.triangles} triangles: convex parts take minutes; 20 000 show a finger as much"


def _of_mass(volume: float, density: float | None) -> Iterator[str]:
    if density is None:
        yield f"a run needs its mass (--mass); of water it would be {WATER * volume:.3g} kg"
    elif density > HEAVIEST:
        yield f"at {density:.3g} kg/m3 it is denser than lead: is its mass in kg, and its size right?"
    elif density < LIGHTEST:
        yield f"at {density:.3g} kg/m3 it is lighter than foam: is its mass in kg, and its size right?"


def _plain(values: Floats) -> Floats:
    """The same with zeros for what is rounding beside the largest."""
    return np.where(np.abs(values) < ROUNDING * np.abs(values).max(), 0.0, values)


def _numbers(values: Vector) -> str:
    return " ".join(f"{round(value, 4) + 0.0:.4f}" for value in values)


def _small(values: Vector) -> str:
    return " ".join(f"{value:10.3e}" for value in values)
