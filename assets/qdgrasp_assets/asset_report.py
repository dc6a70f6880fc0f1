"""Reports on grippers and objects of one's own: all that is known before a run.

An object's report comes from its mesh file, a gripper's from its TOML file and URDF, or from a URDF and the
file that would be guessed for it. All faults are listed in the report, in words.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

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
from qdgrasp_assets.geometry.proximity import resolution_notes
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
from qdgrasp_assets.scene import vector
from qdgrasp_assets.ycb import lengths_in_words
from qdgrasp_protocol.errors import AssetError, QdgraspError
from qdgrasp_protocol.text import counted


class ReportLine(NamedTuple):
    """A line of a report."""

    label: str
    words: str
    values: dict[str, Any]
    """What it says, by name: plain values, for programs."""


class AssetReport(Struct, frozen=True, kw_only=True):
    """Result of an examination of a hand or an object."""

    kind: str
    name: str
    facts: tuple[ReportLine, ...] = ()
    warnings: tuple[str, ...] = ()
    """Signs of wrong guesses, each with the flag that corrects it."""
    notes: tuple[str, ...] = ()
    """Unlikely things that do not prevent its use."""
    faults: tuple[str, ...] = ()
    """Reasons why it cannot be used; empty where it can."""

    @property
    def values(self) -> dict[str, Any]:
        """All that is known, by name: plain values."""
        known = {name: value for fact in self.facts for name, value in fact.values.items()}
        return {"name": self.name, **known, **{key: list(getattr(self, key)) for key in REMARKS}}

    @property
    def table(self) -> str:
        """All facts, one on each line."""
        lines = [(self.kind, self.name), *((fact.label, fact.words) for fact in self.facts)]
        lines += [(label, words) for key, label in REMARKS.items() for words in getattr(self, key)]
        return "\n".join(f"{label:<16} {words}" for label, words in lines)


REMARKS = {"warnings": "warning", "notes": "note", "faults": "WRONG"}
"""Labels of what is remarked in a report."""
WATER = 1000.0  # Density of water [kg/m3]
LIGHTEST, HEAVIEST = 20.0, 12_000.0  # Plausible densities of an object: foam to lead [kg/m3]
ROUNDING = 1e-9
MOST_NAMES = 20  # Geometries that a note names


def inspect_object(
    draft: ObjectDraft,
    name: str,
    *,
    scale: float | None = None,
    mass: float | None = None,
    glued: bool = False,
    parts: bool = True,
) -> AssetReport:
    """Inspect a mesh file before a run is made of it.

    `name` is the object's in the result, `scale` metres to a unit of the file (None: 1), `mass` in kg (None:
    unknown). With `glued`, bodies that are apart are meant to be one rigid object. With `parts` its convex
    parts are found.
    """
    mesh, volumes = draft.mesh, body_volumes(draft.mesh)
    hollows = 0 if draft.faults else int((volumes < 0).sum())
    bodies, notes = len(volumes) - hollows, []
    faults = draft.faults or draft.object_faults(glued=glued)
    facts = list(_surface_facts(mesh, 1.0 if scale is None else scale, bodies, hollows))
    if len(draft.geometries) > 1:
        names = ", ".join(draft.geometries[:MOST_NAMES])
        notes.append(
            f"the file holds {len(draft.geometries)} geometries, which are taken as one object: {names}; "
            "--mesh geometry=NAME takes one"
        )
    if not draft.faults:
        density = None if mass is None else mass / mesh.volume
        facts += _solid_facts(mesh, mass, density)
        facts.append(_parts_fact(mesh if parts and not faults else None))
        notes = [] if faults else [*notes, *_solid_notes(mesh, bodies, hollows, density)]
    repairs = draft.repairs or (() if faults else ("nothing had to be",))
    facts += [ReportLine("repaired", words, {"repairs": list(draft.repairs)}) for words in repairs]
    return AssetReport(kind="object", name=name, facts=tuple(facts), notes=tuple(notes), faults=faults)


def _surface_facts(mesh: Mesh, scale: float, bodies: int, hollows: int) -> Iterator[ReportLine]:
    """Yield the facts of any mesh [m]; `scale` is metres to a unit of its file."""
    unit = "" if scale == 1 else f" ({scale_in_words(scale)})"
    sides = {"scale": scale, "extents": vector(mesh.extents)}
    yield ReportLine("size", f"{lengths_in_words(mesh.extents)} m{unit}", sides)
    triangles, closed = len(mesh.faces), MeshEdges(mesh).is_closed
    words = f"{counted(triangles, 'triangle')}, {'closed' if closed else 'NOT closed'}"
    yield ReportLine("surface", words, {"triangles": triangles, "closed": closed})
    within = f", with {hollows} hollow within" if hollows else ""
    yield ReportLine("bodies", f"{bodies}{within}", {"bodies": bodies, "hollows": hollows})


def _solid_facts(mesh: Mesh, mass: float | None, density: float | None) -> Iterator[ReportLine]:
    """Yield the facts of a closed mesh [m], its mass [kg] and density [kg/m3]; None: unknown."""
    yield ReportLine("volume", f"{mesh.volume * 1e6:.2f} cm3", {"volume": mesh.volume})
    weight = "not said" if mass is None else f"{mass:g} kg, {density:.0f} kg/m3"
    yield ReportLine("mass", weight, {"mass": mass, "density": density})
    centre = vector(_without_rounding(mesh.centre_of_mass))
    words = " ".join(f"{round(value, 4) + 0.0:.4f}" for value in centre)
    yield ReportLine("centre of mass", f"{words} m, frame of the mesh file", {"centre_of_mass": centre})
    rows = [] if mass is None else _without_rounding(mass * mesh.inertia).tolist()
    of = " kg m2, about the centre of mass, solid throughout"
    for turn, row in enumerate(rows):
        numbers = " ".join(f"{value:10.3e}" for value in row)
        yield ReportLine("", numbers, {}) if turn else ReportLine("inertia", numbers + of, {"inertia": rows})
    points = int(POINTS_PER_METRE * np.linalg.norm(mesh.extents))  # of an evaluation under `paper`
    yield ReportLine("surface points", str(points), {"surface_points": points})


def _parts_fact(mesh: Mesh | None) -> ReportLine:
    """Return what stands for a mesh in the simulator; None: it is not looked for."""
    if mesh is None:
        return ReportLine("convex parts", "not looked for", {"convex": None})
    source, convex = collision_parts(mesh)
    fit = FingerClearance(mesh).fit(convex)
    words = (
        f"{len(convex)}, {source}: fill the room before {100 * fit.filled:.1f} % of the surface, "
        f"leave {100 * fit.bare:.1f} % of it out"
    )
    found = {"count": len(convex), "source": source, "filled": fit.filled, "bare": fit.bare}
    return ReportLine("convex parts", words, {"convex": found})


def _solid_notes(mesh: Mesh, bodies: int, hollows: int, density: float | None) -> Iterator[str]:
    """Yield the notes on a closed mesh and its density [kg/m3]; None without a mass."""
    if bodies > 1:
        yield (
            f"its {bodies} bodies are moved as one rigid object, as if they were glued: give things "
            "that move by themselves files of their own"
        )
    if hollows:
        yield "a hollow is aimed at, and no finger reaches it: leave it out unless it matters for the balance"
    inside = FingerClearance(mesh).inside
    if inside:
        yield (
            f"{100 * inside:.1f} % of its surface lies inside it, where it cuts itself or bodies overlap: "
            "such room counts twice in volume and centre of mass, and is aimed at; unite the bodies"
        )
    yield from resolution_notes(mesh)
    if density is None:
        yield f"a run needs its mass (--mass); of water it would be {WATER * mesh.volume:.3g} kg"
    elif not LIGHTEST <= density <= HEAVIEST:
        kind = "denser than lead" if density > HEAVIEST else "lighter than foam"
        yield f"at {density:.3g} kg/m3 it is {kind}: is its mass in kg, and its size right?"


def _without_rounding(values: Floats) -> Floats:
    """Return the matrix with zeros for values that are rounding beside the largest."""
    return np.where(np.abs(values) < ROUNDING * np.abs(values).max(), 0.0, values)


def examine(path: Path, name: str) -> AssetReport:
    """Examine a gripper's TOML file and its URDF; all faults are in the result."""
    try:
        file = read_gripper_file(path)
        robot, faults = read_robot(urdf_path(path, file))
    except QdgraspError as error:
        return AssetReport(kind="gripper", name=name, faults=(str(error).rstrip("."),))
    if robot is None:
        return AssetReport(kind="gripper", name=name, faults=faults)
    return examine_hand(robot, file, name)


def examine_urdf(urdf: Path, name: str) -> tuple[AssetReport, Gripper | None]:
    """Examine a URDF or MJCF file with the file guessed for it; and a gripper to draw.

    It may have links without masses, and visual shapes where no link that moves has others. None where
    nothing can be guessed.
    """
    report = AssetReport(kind="gripper", name=name)
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


def examine_hand(robot: Urdf, file: GripperFile, name: str, warnings: tuple[str, ...] = ()) -> AssetReport:
    """Examine a hand whose file and URDF are read already, with warnings of its draft."""
    base, impossible = file.base_link, [*gripper_faults(file, robot)]
    impossible += hand_faults(robot.subtree(base)) if base in robot.links else ()
    if impossible:
        return AssetReport(
            kind="gripper", name=name, faults=tuple(dict.fromkeys(impossible)), warnings=warnings
        )
    hand = HandPostures(file, read_hand_model(robot, base))
    faults = posture_faults(hand)
    notes = () if faults else (*posture_notes(hand), *_hollow_notes(hand.body.robot))
    facts = tuple(_hand_facts(hand))
    return AssetReport(kind="gripper", name=name, facts=facts, warnings=warnings, notes=notes, faults=faults)


def _hand_facts(hand: HandPostures) -> Iterator[ReportLine]:
    """Yield the facts of a hand whose shapes can be read."""
    file, body = hand.file, hand.body
    yield ReportLine("URDF", str(body.robot.path), {"urdf": str(body.robot.path)})
    yield ReportLine("base link", file.base_link, {"base_link": file.base_link})
    moving, following, fingers = len(body.moving), len(body.followers), len(hand.closing.fingers)
    words = f"{moving} move{f', {following} of them mimic others' if following else ''}"
    yield ReportLine("joints", words, {"joints": moving, "followers": following})
    words = f"{fingers}, with {counted(len(file.finger_links), 'finger link')}"
    yield ReportLine("fingers", words, {"fingers": fingers, "finger_links": file.finger_links})
    if names := [synergy.name for synergy in file.synergies]:
        yield ReportLine("synergies", ", ".join(names), {"synergies": names})
    rated = sum(table.rated_effort is not None for table in file.joints.values())
    values = {"rated": rated, "ratings_source": file.ratings_source}
    yield ReportLine("ratings", f"of {counted(rated, 'joint')}: {file.ratings_source}", values)
    if pairs := file.disabled_collisions:
        words = ", ".join(f"'{one}' and '{other}'" for one, other in pairs)
        yield ReportLine("may overlap", words, {"disabled_collisions": pairs})
    yield ReportLine("licence", file.licence, {"licence": file.licence})
    corners = body.corners(body.parts, hand.posture(0.0))
    sides = vector(np.ptp(corners, axis=0)) if len(corners) else (0.0, 0.0, 0.0)
    yield ReportLine("size", f"{lengths_in_words(sides)} m, open", {"extents": sides})
    yield ReportLine("mass", f"{body.robot.mass:.4g} kg", {"mass": body.robot.mass})
    parts = sum(map(len, body.parts.values()))
    yield ReportLine("shapes", f"{parts} convex parts", {"parts": parts})


def _hollow_notes(hand: Urdf) -> Iterator[str]:
    if hollow := ", ".join(f"{link} {100 * filled:.0f} %" for link, filled in hollow_meshes(hand)):
        yield (
            "the simulator wraps each collision mesh in its convex hull, which fills the room before "
            f"much of the surface of {hollow}: "
            "`qdgrasp gripper new --repair` splits such meshes into convex parts"
        )


def examine_gripper(name: str) -> AssetReport:
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
