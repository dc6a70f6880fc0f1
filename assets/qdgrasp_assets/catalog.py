"""The catalog: names of grippers and objects, and the scene of one of each."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct, structs

from qdgrasp_assets import ycb
from qdgrasp_assets.asset_paths import A_FOLDER, NOT_THERE, named_path, path_problem, read_table, searched
from qdgrasp_assets.geometry import mesh
from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.geometry.mesh_io import check_file
from qdgrasp_assets.geometry.resting_poses import chosen_resting_poses
from qdgrasp_assets.geometry.rotation import Floats, from_euler, rotate, unit
from qdgrasp_assets.geometry.voxels import convex_hulls
from qdgrasp_assets.grippers.collision_shapes import check_convex
from qdgrasp_assets.grippers.gripper import Gripper, read_gripper
from qdgrasp_assets.grippers.gripper_file import read_gripper_file
from qdgrasp_assets.grippers.hand_model import are_deep
from qdgrasp_assets.object_model import ObjectFacts, ObjectModel, file_facts
from qdgrasp_assets.object_shape import FARTHEST, ObjectShape, file_shape, is_in_catalog, shape_of
from qdgrasp_assets.regions import with_regions
from qdgrasp_assets.scene import BodyGeometry, Scene, SceneGripper, SceneObject, Vector
from qdgrasp_assets.stand_ins import LICENCE, STAND_INS, stand_in
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName
from qdgrasp_protocol.rows import MAX_CONTACT_SLOTS
from qdgrasp_protocol.spec import RunSpec

GRIPPERS = Path(__file__).parent / "grippers"
ABSENT = "absent"
REFERENCE = "ref_"  # Prefix of the names of the reference hands
ROLLING_FRICTION = 0.01
SPINNING_FRICTION = 0.1
CONTACTS_PER_FINGER_LINK = 4  # Most contacts of two convex shapes in Bullet


@dataclass(frozen=True)
class CatalogEntry:
    """One line of the catalog."""

    name: str
    source: str
    """Source: "built in", "asset path", "fetched" or "absent"."""
    licence: str


def build_scene(spec: RunSpec, tell: Tell = ignore_progress, known: ObjectShape | None = None) -> Scene:
    """Build the scene of a run's spec; the same spec and files give the same bits.

    The shape of a mesh file is `known`, or taken from the store on the disk where it is there. `tell` is
    called with a sentence before each slow step. Raises `UnknownName` for a gripper or object that is neither
    known nor a file, and `AssetError` where one of its files cannot be used.
    """
    if known is None:
        gripper_path(spec.gripper)  # an unknown hand is reported first
        check_object(spec.object)  # before the hand is read, which takes longer
    hand, (facts, shape) = carried_hand(spec), _facts_and_shape(spec, tell, known)
    scene = Scene(
        protocol=spec.protocol,
        base=spec.base,
        engine=spec.engine,
        gripper=hand,
        object=SceneObject(
            rolling_friction=ROLLING_FRICTION,
            spinning_friction=SPINNING_FRICTION,
            **{key: getattr(facts, key) for key in ObjectFacts.__dataclass_fields__},
            **{key: getattr(shape, key) for key in BodyGeometry.__struct_fields__},
        ),
        **structs.asdict(shape.surface),
        contact_slots=min(MAX_CONTACT_SLOTS, CONTACTS_PER_FINGER_LINK * len(hand.finger_links)),
        approach_distance=spec.approach,
        resting_poses=tuple(chosen_resting_poses(shape.collision, spec.table_pose, spec.object).values()),
        neighbours=neighbour_parts(spec, shape),
    )
    return with_regions(scene, spec) if spec.on or spec.avoid else scene


def carried_hand(spec: RunSpec) -> SceneGripper:
    """Return the hand of a spec on the carrier of its protocol; errors of `build_scene`."""
    hand = find_gripper(spec.gripper).on_carrier(spec.nominal_protocol)
    if spec.engine:
        check_convex(hand)
    return hand


def object_shape(spec: RunSpec) -> ObjectShape:
    """Return the shape of a spec's object, for any gripper; errors of `build_scene`."""
    check_object(spec.object)
    return _facts_and_shape(spec)[1]


def _facts_and_shape(
    spec: RunSpec, tell: Tell = ignore_progress, known: ObjectShape | None = None
) -> tuple[ObjectFacts, ObjectShape]:
    if is_in_catalog(spec.object):
        target = find_object(spec)
        return target, shape_of(target, spec.protocol, spec.surface_seed)
    return file_facts(spec), known or file_shape(spec, tell)


OVERLAPPING = 1e-3  # Depth from which a body overlaps the object, and does not only touch it [m]
PROTOCOLS = ("physical", "lift")
Side = Annotated[float, Meta(gt=0, le=FARTHEST)]
Place = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]


class Body(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A fixed body, of one of three kinds, placed in the frame of the object's mesh."""

    mesh: str | None = None
    """A mesh file; a relative path begins in the folder of the scene's file."""
    object: str | None = None
    """An object of the catalog, in the frame of its mesh."""
    box: tuple[Side, Side, Side] | None = None
    """Sides of a box around its own origin [m]."""
    scale: float | None = None
    """Metres to a unit of the mesh file; None: 1."""
    position: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)
    """Place of its origin [m]."""
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Its rotation, xyzw, of any length; zeros: `rpy` is taken."""
    rpy: Vector = (0.0, 0.0, 0.0)
    """Its rotation about the fixed axes x, then y, then z [rad]."""

    def placed(self, corners: Floats) -> Floats:
        """Return corners (v, 3) [m] of its own frame in that of the object's mesh."""
        turn = (
            unit(np.array(self.quaternion)) if any(self.quaternion) else from_euler(np.array([self.rpy]))[0]
        )
        return np.asarray(rotate(turn, corners) + np.array(self.position))


Bodies = Annotated[tuple[Body, ...], Meta(min_length=1, max_length=50)]
SceneFile = Annotated[dict[Literal["body"], Bodies], Meta(min_length=1)]


def neighbour_parts(spec: RunSpec, shape: ObjectShape) -> bytes:
    """Return the convex parts around a spec's object as an OBJ file; empty without a scene.

    They are in the CoM frame of that object, which has this shape. Raises AssetError for a file or body that
    cannot be used, ImpossibleValue for the protocol, and errors of `build_scene` for other objects.
    """
    if spec.scene is None:
        return b""
    if spec.nominal_protocol not in PROTOCOLS:
        raise ImpossibleValue("The protocol of a run with a scene", spec.protocol, " or ".join(PROTOCOLS))
    path = named_path(spec.scene)
    bodies = read_table(path, SceneFile, "scene", "docs/where.md")["body"]
    target, around = convex_hulls(shape_corners(shape)), list[Floats]()
    for number, body in enumerate(bodies, start=1):
        where = f"The body {number} in '{path}'"
        if [body.mesh, body.object, body.box].count(None) != 2:
            raise AssetError(f"{where} must have one of mesh, object and box.")
        name = str(path.parent / body.mesh) if body.mesh else body.object
        other = structs.replace(spec, object=name or "", scale=body.scale, mesh=None, mass=1.0)
        own = shape_corners(object_shape(other)) if name else [mesh.box(body.box or (1, 1, 1)).vertices]
        placed = [body.placed(corners) for corners in own]
        if are_deep(target, convex_hulls(placed), OVERLAPPING):
            raise AssetError(f"{where} overlaps the object, or holds it inside; place it beside the object.")
        around += placed
    return mesh.parts_to_obj(mesh.hull(corners).moved(np.negative(shape.com_in_mesh)) for corners in around)


def shape_corners(shape: ObjectShape) -> list[Floats]:
    """Return the corners (v, 3) [m] of an object's convex parts, in the frame of its mesh."""
    return [
        part.vertices + np.array(shape.com_in_mesh) for part in mesh.parse_parts(shape.collision.decode())
    ]


def find_gripper(name: str) -> Gripper:
    """Return the gripper of this name or file.

    Reference hands keep the masses that their authors left to the simulator. Errors of `build_scene`.
    """
    path = gripper_path(name)
    if path.parent == GRIPPERS:
        return read_gripper(path, name, _gripper_source(name))
    own = read_gripper(path, path.stem, path.name)
    own.check_hand()
    return own


def gripper_path(name: str) -> Path:
    """Return the path of a gripper's TOML file, by its name or path; or raise `UnknownName`."""
    built_in = GRIPPERS / f"{name}.toml"
    if built_in.parent == GRIPPERS and built_in.is_file():
        return built_in
    path = named_path(name)
    if not _is_file(path):
        hint = f"Or name a gripper's TOML file. Reference hands lie on the asset path ({searched()})."
        raise UnknownName("gripper", name, gripper_names(), hint)
    return path


def find_object(spec: RunSpec) -> ObjectModel:
    """Return the object of a spec, one of the catalog, with its mass and friction."""
    name = spec.object
    if spec.scale is not None or spec.mesh is not None:
        raise AssetError(
            f"The object '{name}' of the catalog has its own size and surface: leave --units and --mesh out, "
            "which are for mesh files."
        )
    target = stand_in(name) if name in STAND_INS else ycb.read_scan(name, spec.protocol)
    mass = target.mass if spec.mass is None else spec.mass
    friction = target.lateral_friction if spec.friction is None else spec.friction
    return replace(target, mass=mass, lateral_friction=friction)


def check_object(name: str) -> None:
    """Check that a name is a stand-in, a scan or file that is there; errors of `build_scene`."""
    if name in ycb.SCAN_NAMES:
        ycb.check_there(name)
    elif name not in STAND_INS and path_problem(path := named_path(name)) == A_FOLDER:
        check_file(path)
    elif name not in STAND_INS and not _is_file(path):
        hint = f"Or name a mesh file, with its mass. Scans lie on the asset path ({searched()})."
        raise UnknownName("object", name, object_names(), hint)


def gripper_names() -> tuple[str, ...]:
    """Return the names of the grippers whose files are there."""
    return tuple(each.name for each in every_gripper() if each.source != ABSENT)


def object_names() -> tuple[str, ...]:
    """Return the names of the stand-ins, and of the scans that are there."""
    return tuple(each.name for each in every_object() if each.source != ABSENT)


def every_gripper() -> tuple[CatalogEntry, ...]:
    """Return all grippers that this package knows, also those whose files are absent."""
    found = []
    for path in sorted(GRIPPERS.glob("*.toml")):
        file = read_gripper_file(path)
        source = ABSENT if file.find_urdf(path) is None else _gripper_source(path.stem)
        found.append(CatalogEntry(path.stem, source, file.licence))
    return tuple(found)


def every_object() -> tuple[CatalogEntry, ...]:
    """Return all stand-ins and scans, also absent ones."""
    own = tuple(CatalogEntry(name, "built in", LICENCE) for name in STAND_INS)
    return own + tuple(CatalogEntry(name, ycb.scan_source(name), ycb.LICENCE) for name in ycb.SCAN_NAMES)


def _gripper_source(name: str) -> str:
    return "asset path" if name.startswith(REFERENCE) else "built in"


def _is_file(path: Path) -> bool:
    """Return whether a name means a file rather than an entry of the catalog."""
    return bool(path.suffix) or len(path.parts) > 1 or path_problem(path) != NOT_THERE
