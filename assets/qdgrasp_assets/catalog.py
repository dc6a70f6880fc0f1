"""The catalog: names of grippers and objects, and the scene made of one of each."""

from dataclasses import dataclass, replace
from pathlib import Path

from qdgrasp_assets import ycb
from qdgrasp_assets.asset_paths import A_FOLDER, NOT_THERE, named_path, path_problem, searched
from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.geometry.mesh_io import check_file
from qdgrasp_assets.geometry.resting_poses import chosen_resting_poses
from qdgrasp_assets.grippers.collision_shapes import check_convex
from qdgrasp_assets.grippers.gripper import Gripper, read_gripper
from qdgrasp_assets.grippers.gripper_file import read_gripper_file
from qdgrasp_assets.object_model import ObjectFacts, ObjectModel, file_facts
from qdgrasp_assets.object_shape import ObjectShape, file_shape, is_in_catalog, shape_of
from qdgrasp_assets.scene import Scene, SceneGripper, SceneObject
from qdgrasp_assets.stand_ins import LICENCE, STAND_INS, stand_in
from qdgrasp_protocol.errors import AssetError, UnknownName
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

    @property
    def is_there(self) -> bool:
        """True if it can be used here."""
        return self.source != ABSENT


def build_scene(spec: RunSpec, tell: Tell = ignore_progress) -> Scene:
    """Build the scene of a run's spec; the same spec and files give the same bits.

    The shape of a mesh file is taken from the store on the disk where it is there. `tell` is called with a
    sentence before each slow step. Raises `UnknownName` for a gripper or object that is neither known nor a
    file, and `AssetError` where one of its files cannot be used.
    """
    gripper_path(spec.gripper)  # an unknown hand is reported first
    check_object(spec.object)  # before the hand is read, which takes longer
    return _scene(spec, carried_hand(spec), *_facts_and_shape(spec, tell))


def assemble_scene(spec: RunSpec, shape: ObjectShape) -> Scene:
    """Assemble the scene of a spec, a mesh file of this shape; errors of `build_scene`."""
    return _scene(spec, carried_hand(spec), file_facts(spec), shape)


def carried_hand(spec: RunSpec) -> SceneGripper:
    """Return the hand of a spec on the carrier of its protocol; errors of `build_scene`."""
    hand = find_gripper(spec.gripper).on_carrier(spec.nominal_protocol)
    if spec.engine:
        check_convex(hand)
    return hand


def _scene(spec: RunSpec, hand: SceneGripper, facts: ObjectFacts, shape: ObjectShape) -> Scene:
    return Scene(
        protocol=spec.protocol,
        base=spec.base,
        engine=spec.engine,
        gripper=hand,
        object=SceneObject(
            name=facts.name,
            source=facts.source,
            licence=facts.licence,
            collision_source=shape.collision_source,
            mass=facts.mass,
            lateral_friction=facts.lateral_friction,
            rolling_friction=ROLLING_FRICTION,
            spinning_friction=SPINNING_FRICTION,
            com_in_mesh=shape.com_in_mesh,
            collision=shape.collision,
            mesh_vertices=shape.mesh_vertices,
            mesh_faces=shape.mesh_faces,
        ),
        points=shape.points,
        normals=shape.normals,
        finder_low=shape.finder_low,
        finder_high=shape.finder_high,
        object_low=shape.object_low,
        object_high=shape.object_high,
        contact_slots=min(MAX_CONTACT_SLOTS, CONTACTS_PER_FINGER_LINK * len(hand.finger_links)),
        approach_distance=spec.approach,
        resting_poses=tuple(chosen_resting_poses(shape.collision, spec.table_pose, spec.object).values()),
    )


def object_shape(spec: RunSpec) -> ObjectShape:
    """Return the shape of a spec's object, for any gripper; errors of `build_scene`."""
    check_object(spec.object)
    return _facts_and_shape(spec, ignore_progress)[1]


def _facts_and_shape(spec: RunSpec, tell: Tell) -> tuple[ObjectFacts, ObjectShape]:
    if is_in_catalog(spec.object):
        target = find_object(spec)
        return target, shape_of(target, spec.protocol, spec.surface_seed)
    return file_facts(spec), file_shape(spec, tell)


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
    if built_in in _gripper_files():
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
    return tuple(listing.name for listing in every_gripper() if listing.is_there)


def object_names() -> tuple[str, ...]:
    """Return the names of the stand-ins, and of the scans that are there."""
    return tuple(listing.name for listing in every_object() if listing.is_there)


def every_gripper() -> tuple[CatalogEntry, ...]:
    """Return all grippers that this package knows, also those whose files are absent."""
    found = []
    for path in _gripper_files():
        file = read_gripper_file(path)
        source = ABSENT if file.find_urdf(path) is None else _gripper_source(path.stem)
        found.append(CatalogEntry(path.stem, source, file.licence))
    return tuple(found)


def every_object() -> tuple[CatalogEntry, ...]:
    """Return all stand-ins and scans, also absent ones."""
    own = tuple(CatalogEntry(name, "built in", LICENCE) for name in STAND_INS)
    return own + tuple(CatalogEntry(name, ycb.scan_source(name), ycb.LICENCE) for name in ycb.SCAN_NAMES)


def _gripper_files() -> tuple[Path, ...]:
    return tuple(sorted(GRIPPERS.glob("*.toml")))


def _gripper_source(name: str) -> str:
    return "asset path" if name.startswith(REFERENCE) else "built in"


def _is_file(path: Path) -> bool:
    """Return whether a name means a file rather than an entry of the catalog."""
    return bool(path.suffix) or len(path.parts) > 1 or path_problem(path) != NOT_THERE
