"""Reports on grippers and objects of one's own: all that is known before a run.

An object's report comes from its mesh file, a gripper's from its TOML file and URDF, or from a URDF and the
file that would be guessed for it. All faults are listed in the report, in words.
"""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets import catalog
from qdgrasp_assets.geometry.collision_parts import (
    FingerClearance,
    collision_parts,
)
from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.mesh_io import scale_in_words
from qdgrasp_assets.geometry.mesh_repair import MeshEdges, body_volumes
from qdgrasp_assets.geometry.proximity import resolution_notes, thin_share
from qdgrasp_assets.geometry.surface_points import POINTS_PER_METRE
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper
from qdgrasp_assets.gripper_setup.posture_checks import HandPostures, posture_faults, posture_notes
from qdgrasp_assets.gripper_setup.repaired_copy import hollow_meshes, with_visual_shapes
from qdgrasp_assets.grippers.gripper import Gripper
from qdgrasp_assets.grippers.gripper_file import GripperFile, gripper_faults, read_gripper_file, urdf_path
from qdgrasp_assets.grippers.hand_model import guess_base, read_hand_model
from qdgrasp_assets.grippers.mjcf import is_mjcf, read_mjcf
from qdgrasp_assets.grippers.urdf import Urdf, parse_robot, read_robot_element, structure_faults
from qdgrasp_assets.grippers.urdf_checks import hand_faults, motion_faults, weight_faults
from qdgrasp_assets.object_model import ObjectDraft
from qdgrasp_assets.scene import Vector, vector
from qdgrasp_assets.ycb import lengths_in_words
from qdgrasp_protocol.errors import AssetError, QdgraspError
from qdgrasp_protocol.text import counted


class AssetReport(Struct, frozen=True, kw_only=True):
    """Base of the results of an examination; each kind adds fields and lines."""

    name: str
    notes: tuple[str, ...] = ()
    """Unlikely things that do not prevent its use."""
    faults: tuple[str, ...] = ()
    """Reasons why it cannot be used; empty where it can."""

    @property
    def table(self) -> str:
        """All facts, one on each line."""
        notes, faults = (("note", words) for words in self.notes), (("WRONG", words) for words in self.faults)
        return "\n".join(f"{label:<16} {words}" for label, words in (*self._lines(), *notes, *faults))

    def _lines(self) -> Iterator[tuple[str, str]]:
        """Return the lines of the table as label and text, without notes and faults."""
        yield "name", self.name


WATER = 1000.0  # Density of water [kg/m3]
LIGHTEST, HEAVIEST = 20.0, 12_000.0  # Plausible densities of an object: foam to lead [kg/m3]
ROUNDING = 1e-9
MOST_NAMES = 20  # Geometries that a note names


class ConvexPartsReport(Struct, frozen=True, kw_only=True):
    """The convex parts that stand for an object in the simulator."""

    count: int
    source: str
    """"own hull" or "cuts"."""
    filled: float
    """Share of the surface in front of which they fill free space, 0 to 1."""
    bare: float
    """Share of the surface that is outside all of them, 0 to 1."""

    @property
    def words(self) -> str:
        """Description in words."""
        return (
            f"{self.count}, {self.source}: fill the room before {100 * self.filled:.1f} % of the surface, "
            f"leave {100 * self.bare:.1f} % of it out"
        )


class ObjectReport(AssetReport, frozen=True, kw_only=True):
    """Result of the inspection of a mesh file."""

    scale: float
    """Metres to a unit of the file."""
    extents: Vector
    """Sides of the bounding box [m]."""
    triangles: int
    closed: bool
    """True if every edge has an even number of triangles, usually two."""
    bodies: int
    """Number of bodies that do not touch; they are one rigid object."""
    hollows: int = 0
    """Number of closed spaces within bodies."""
    volume: float | None = None
    """[m3]; None, as in the fields below, for a mesh that cannot be used."""
    mass: float | None = None
    """Mass [kg]; None: unknown."""
    density: float | None = None
    """Density [kg/m3]; None without a mass."""
    centre_of_mass: Vector | None = None
    """Centre of mass at uniform density, in the mesh file's frame [m]."""
    inertia: tuple[Vector, Vector, Vector] | None = None
    """Inertia about the centre of mass, uniform density, mesh axes [kg m2]; None without a mass."""
    surface_points: int | None = None
    """Number of surface points of an evaluation under `paper`."""
    convex: ConvexPartsReport | None = None
    """Its convex parts; None also if they were not asked for."""
    repairs: tuple[str, ...] = ()

    def _lines(self) -> Iterator[tuple[str, str]]:
        yield "object", self.name
        unit = "" if self.scale == 1 else f" ({scale_in_words(self.scale)})"
        yield "size", f"{lengths_in_words(self.extents)} m{unit}"
        yield "surface", f"{counted(self.triangles, 'triangle')}, {'closed' if self.closed else 'NOT closed'}"
        yield "bodies", f"{self.bodies}" + (f", with {self.hollows} hollow within" if self.hollows else "")
        if self.volume is not None and self.centre_of_mass is not None:
            yield "volume", f"{self.volume * 1e6:.2f} cm3"
            yield "mass", "not said" if self.mass is None else f"{self.mass:g} kg, {self.density:.0f} kg/m3"
            centre = " ".join(f"{round(value, 4) + 0.0:.4f}" for value in self.centre_of_mass)
            yield "centre of mass", f"{centre} m, frame of the mesh file"
            words = " kg m2, about the centre of mass, solid throughout"
            for turn, row in enumerate(self.inertia or ()):
                numbers = " ".join(f"{value:10.3e}" for value in row)
                yield ("", numbers) if turn else ("inertia", numbers + words)
            yield "surface points", f"{self.surface_points}"
            yield "convex parts", self.convex.words if self.convex else "not looked for"
        repairs = self.repairs or (() if self.faults else ("nothing had to be",))
        yield from (("repaired", words) for words in repairs)


def inspect_object(
    draft: ObjectDraft,
    name: str,
    *,
    scale: float | None = None,
    mass: float | None = None,
    glued: bool = False,
    parts: bool = True,
) -> ObjectReport:
    """Inspect a mesh file before a run is made of it.

    `name` is the object's in the result, `scale` metres to a unit of the file (None: 1), `mass` in kg (None:
    unknown). With `glued`, bodies that are apart are meant to be one rigid object. With `parts` its convex
    parts are found.
    """
    mesh, volumes = draft.mesh, body_volumes(draft.mesh)
    hollows = 0 if draft.faults else int((volumes < 0).sum())
    found = ObjectReport(
        name=name,
        scale=1.0 if scale is None else scale,
        extents=vector(mesh.extents),
        triangles=len(mesh.faces),
        closed=MeshEdges(mesh).is_closed,
        bodies=len(volumes) - hollows,
        hollows=hollows,
        repairs=draft.repairs,
        faults=draft.faults,
    )
    notes = []
    if len(draft.geometries) > 1:
        names = ", ".join(draft.geometries[:MOST_NAMES])
        notes.append(
            f"the file holds {len(draft.geometries)} geometries, which are taken as one object: {names}; "
            "--mesh geometry=NAME takes one"
        )
    if found.faults:
        return msgspec.structs.replace(found, notes=tuple(notes))
    density = None if mass is None else mass / mesh.volume
    rows = () if mass is None else _without_rounding(mass * mesh.inertia)
    found = msgspec.structs.replace(
        found,
        volume=mesh.volume,
        mass=mass,
        density=density,
        centre_of_mass=vector(_without_rounding(mesh.centre_of_mass)),
        inertia=None if mass is None else tuple(vector(row) for row in rows),
        surface_points=int(POINTS_PER_METRE * np.linalg.norm(mesh.extents)),
        notes=(*notes, *_solid_notes(found, mesh, density)),
    )
    if faults := draft.object_faults(glued=glued):
        return msgspec.structs.replace(found, notes=(), faults=faults)
    if not parts:
        return found
    source, convex = collision_parts(mesh)
    fit = FingerClearance(mesh).fit(convex)
    fitted = ConvexPartsReport(count=len(convex), source=source, filled=fit.filled, bare=fit.bare)
    return msgspec.structs.replace(found, convex=fitted)


def _solid_notes(found: ObjectReport, mesh: Mesh, density: float | None) -> Iterator[str]:
    """Yield the notes on a closed mesh and its density [kg/m3]; None without a mass."""
    if found.bodies > 1:
        yield (
            f"its {found.bodies} bodies are moved as one rigid object, as if they were glued: give things "
            "that move by themselves files of their own"
        )
    if found.hollows:
        yield "a hollow is aimed at, and no finger reaches it: leave it out unless it matters for the balance"
    inside = FingerClearance(mesh).inside
    if inside:
        yield (
            f"{100 * inside:.1f} % of its surface lies inside it, where it cuts itself or bodies overlap: "
            "such room counts twice in volume and centre of mass, and is aimed at; unite the bodies"
        )
    yield from resolution_notes(mesh.extents, thin_share(mesh))
    if density is None:
        yield f"a run needs its mass (--mass); of water it would be {WATER * mesh.volume:.3g} kg"
    elif not LIGHTEST <= density <= HEAVIEST:
        kind = "denser than lead" if density > HEAVIEST else "lighter than foam"
        yield f"at {density:.3g} kg/m3 it is {kind}: is its mass in kg, and its size right?"


def _without_rounding(values: Floats) -> Floats:
    """Return the matrix with zeros for values that are rounding beside the largest."""
    return np.where(np.abs(values) < ROUNDING * np.abs(values).max(), 0.0, values)


class GripperReport(AssetReport, frozen=True, kw_only=True):
    """Result of the examination of a hand."""

    urdf: str = ""
    base_link: str = ""
    licence: str = ""
    joints: int = 0
    """Number of moving joints."""
    followers: int = 0
    """Number of these that mimic another one."""
    fingers: int = 0
    finger_links: tuple[str, ...] = ()
    synergies: tuple[str, ...] = ()
    rated: int = 0
    """Number of joints with ratings of the real drive."""
    ratings_source: str = ""
    disabled_collisions: tuple[tuple[str, str], ...] = ()
    mass: float | None = None
    """Mass [kg]."""
    extents: tuple[float, float, float] | None = None
    """Sides of the box around the open hand, base link's frame [m]."""
    parts: int = 0
    """Convex parts that the simulator makes of the collision shapes."""
    warnings: tuple[str, ...] = ()
    """Signs of wrong guesses, each with the flag that corrects it."""

    def _lines(self) -> Iterator[tuple[str, str]]:
        yield "gripper", self.name
        if self.base_link:
            yield "URDF", self.urdf
            yield "base link", self.base_link
            mimics = f", {self.followers} of them mimic others" if self.followers else ""
            yield "joints", f"{self.joints} move{mimics}"
            yield "fingers", f"{self.fingers}, with {counted(len(self.finger_links), 'finger link')}"
            if self.synergies:
                yield "synergies", ", ".join(self.synergies)
            yield "ratings", f"of {counted(self.rated, 'joint')}: {self.ratings_source}"
            if self.disabled_collisions:
                pairs = (f"'{one}' and '{other}'" for one, other in self.disabled_collisions)
                yield "may overlap", ", ".join(pairs)
            yield "licence", self.licence
        if self.extents is not None:
            yield "size", f"{' x '.join(f'{side:.4f}' for side in self.extents)} m, open"
            yield "mass", f"{self.mass:.4g} kg"
            yield "shapes", f"{self.parts} convex parts"
        yield from (("warning", words) for words in self.warnings)


def examine(path: Path, name: str) -> GripperReport:
    """Examine a gripper's TOML file and its URDF; all faults are in the result."""
    try:
        file = read_gripper_file(path)
        robot, faults = read_robot(urdf_path(path, file))
    except QdgraspError as error:
        return GripperReport(name=name, faults=(str(error).rstrip("."),))
    return GripperReport(name=name, faults=faults) if robot is None else examine_hand(robot, file, name)


def examine_urdf(urdf: Path, name: str) -> tuple[GripperReport, Gripper | None]:
    """Examine a URDF or MJCF file with the file guessed for it; and a gripper to draw.

    It may have links without masses, and visual shapes where no link that moves has others. None where
    nothing can be guessed.
    """
    report = GripperReport(name=name)
    try:
        robot, faults, notes = read_hand(urdf)
        if robot is None:
            return msgspec.structs.replace(report, faults=faults), None
        base, shown = guess_base(robot)[0], with_visual_shapes(robot)
        if faults := hand_faults(robot.subtree(base)):
            return msgspec.structs.replace(report, faults=faults), None
        draft = draft_gripper(shown, str(urdf), DraftOverrides(base_link=base))
        found = examine_hand(robot, draft.file, name, draft.warnings)
    except QdgraspError as error:
        return msgspec.structs.replace(report, faults=(str(error).rstrip("."),)), None
    gripper = Gripper(name, urdf.name, draft.file, shown)
    return msgspec.structs.replace(found, notes=(*notes, *found.notes)), gripper


def read_hand(path: Path) -> tuple[Urdf | None, tuple[str, ...], tuple[str, ...]]:
    """Return the robot of a URDF or MJCF file, its faults, and how an MJCF file was translated.

    Errors as in `read_robot` and `read_mjcf`.
    """
    if not is_mjcf(path):
        return *read_robot(path), ()
    robot, notes = read_mjcf(path)
    return robot, (), notes


def read_robot(urdf: Path) -> tuple[Urdf | None, tuple[str, ...]]:
    """Return the robot of a URDF, and its faults; None if it is not a tree.

    Raises `AssetError` if there is no such file, or it is no URDF.
    """
    element = read_robot_element(urdf)
    try:
        return parse_robot(urdf, element), ()
    except AssetError as error:
        faults = structure_faults(element) or (str(error).rstrip("."),)
    return None, (*faults, *motion_faults(element), *weight_faults(element))


def examine_hand(robot: Urdf, file: GripperFile, name: str, warnings: tuple[str, ...] = ()) -> GripperReport:
    """Examine a hand whose file and URDF are read already, with warnings of its draft."""
    base, impossible = file.base_link, [*gripper_faults(file, robot)]
    impossible += hand_faults(robot.subtree(base)) if base in robot.links else ()
    if impossible:
        return GripperReport(name=name, faults=tuple(dict.fromkeys(impossible)), warnings=warnings)
    body = read_hand_model(robot, file.base_link)
    hand = HandPostures(file, body)
    corners = body.corners(body.parts, hand.posture(0.0))
    faults = posture_faults(hand)
    notes = () if faults else (*posture_notes(hand), *_hollow_notes(body.robot))
    return GripperReport(
        name=name,
        urdf=str(body.robot.path),
        base_link=file.base_link,
        licence=file.licence,
        joints=len(body.moving),
        followers=len(body.followers),
        fingers=len(hand.closing.fingers),
        finger_links=file.finger_links,
        synergies=tuple(synergy.name for synergy in file.synergies),
        rated=sum(table.rated_effort is not None for table in file.joints.values()),
        ratings_source=file.ratings_source,
        disabled_collisions=file.disabled_collisions,
        mass=body.robot.mass,
        extents=vector(np.ptp(corners, axis=0)) if len(corners) else (0.0, 0.0, 0.0),
        parts=sum(map(len, body.parts.values())),
        notes=notes,
        faults=faults,
        warnings=warnings,
    )


def _hollow_notes(hand: Urdf) -> Iterator[str]:
    if hollow := ", ".join(f"{link} {100 * filled:.0f} %" for link, filled in hollow_meshes(hand)):
        yield (
            "the simulator wraps each collision mesh in its convex hull, which fills the room before "
            f"much of the surface of {hollow}: "
            "`qdgrasp gripper new --repair` splits such meshes into convex parts"
        )


def examine_gripper(name: str) -> GripperReport:
    """Examine a gripper of the catalog, or a gripper's file; `UnknownName` if it is neither.

    A reference hand is as its authors published it, with limits that have a meaning of their own: faults of
    other hands are only notes for it.
    """
    found = examine(catalog.gripper_path(name), name)
    if not found.faults or not name.startswith(catalog.REFERENCE):
        return found
    try:
        catalog.find_gripper(name)
    except QdgraspError:
        return found
    return msgspec.structs.replace(found, notes=found.faults, faults=())
