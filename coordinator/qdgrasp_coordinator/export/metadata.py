"""Metadata of a file of grasps: frames, units, success, licences, source runs."""

import hashlib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgpack
import msgspec
from msgspec import Struct

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import Scene, SceneGripper, SceneObject
from qdgrasp_coordinator.export.frames import COM, Frame, jaw_turn, to_matrices, turn_hand_axes
from qdgrasp_coordinator.export.grasp_set import Grasps
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_protocol.rows import trial_count
from qdgrasp_protocol.spec import RunSpec, from_toml, to_toml
from qdgrasp_protocol.text import join_numbers

SUCCESS_WORDS = "a finger touches the object after closing"
GRASP_WORDS = "a success that survives at least one of the two shakes: fitness 1 or 2"
FITNESS_MEANING = "shakes survived in the nominal evaluation: 0, 1 or 2; higher is better"
ETA_WORDS = (
    "the share of shakes survived in all trials with disturbed pose and friction, "
    "the estimated probability of transfer"
)
MESH_FILE = "the mesh file"
MESH_WRITTEN = "the mesh that `qdgrasp export --format graspgen --frame mesh` writes"
"""Of an object that is built in or from the asset path."""
OBJECT_FRAMES: dict[Frame, str] = {
    "mesh": "that of {}: its origin and axes, its lengths times object_scale",
    "com": "origin at the centre of mass, axes of {}",
}
UNITS = "m, rad, kg"
XYZW = "x, y, z, w"


class SourceRun(Struct, frozen=True, kw_only=True):
    """A run that found grasps of a file."""

    run: str
    """The name of its folder."""
    digest: str
    """The sha256 over its rows, as `qdgrasp digest` prints it; of a run in progress over those by now."""
    spec: str
    """Its spec as TOML: files by their names alone, and without the poses of one that scored given ones."""

    @property
    def asked(self) -> RunSpec:
        """The spec."""
        return from_toml(self.spec, self.run)


class GraspMetadata(Struct, frozen=True, kw_only=True):
    """What a file says of itself. Lengths are metres."""

    qdgrasp: str
    """The version that wrote it."""
    gripper: str
    gripper_frame: str
    """The link of the hand whose poses are told."""
    gripper_axes: str
    """How the told axes lie on that link."""
    gripper_source: str
    """"built in", "asset path" or a file's name."""
    gripper_licence: str
    gripper_sha256: str = ""
    """Of what a scene bundle holds of it; empty in a file of an earlier version."""
    object: str
    object_file: str
    """The mesh file's name; empty for an object that is built in or from the asset path."""
    object_scale: float
    """What the lengths in the mesh file are multiplied by to be metres."""
    object_frame: str
    """In words, what `frame` says."""
    frame: Frame
    """"mesh" or "com"."""
    object_com: tuple[float, float, float]
    """The centre of mass in that frame [m]."""
    com_in_mesh: tuple[float, float, float]
    """The centre of mass in the frame of the mesh [m]: mesh = com + this."""
    object_mass: float
    """[kg]."""
    object_friction: float
    """Lateral friction coefficient."""
    object_source: str
    object_licence: str
    object_sha256: str = ""
    """The same."""
    collision_parts: str
    """Where the convex parts that were simulated came from."""
    quaternions: str
    """The order in which this file has their components."""
    units: str = UNITS
    protocol: str
    """The evaluation protocol."""
    success: str = SUCCESS_WORDS
    grasp: str = GRASP_WORDS
    fitness: str = FITNESS_MEANING
    confidence: str
    """What it is, 0 to 1; higher is better."""
    scene: str
    """sha256 of the scene bundle."""
    runs: tuple[SourceRun, ...]

    @property
    def values(self) -> dict[str, Any]:
        """As plain values."""
        values: dict[str, Any] = msgspec.to_builtins(self)
        return values

    @property
    def json(self) -> str:
        """As one JSON object."""
        return msgspec.json.encode(self).decode()

    def told(self, *, axes: str | None = None, quaternions: str | None = None) -> "GraspMetadata":
        """The same for a file with these axes of the hand, and this order of quaternions."""
        changed = {"gripper_axes": axes, "quaternions": quaternions}
        return msgspec.structs.replace(self, **{name: told for name, told in changed.items() if told})


def grasp_metadata(folder: RunFolder, grasps: Grasps, frame: Frame) -> GraspMetadata:
    """What a file of grasps from a run's folder says, told in a frame of the object."""
    scene = grasps.scene
    hand, body = scene.gripper, scene.object
    file = Path(grasps.spec.object).name if Path(grasps.spec.object).suffix else ""
    with folder.journal() as journal:
        runs, bundle = _source_runs(folder, journal), journal.scene
    return GraspMetadata(
        qdgrasp=version("qdgrasp"),
        gripper=hand.name,
        gripper_frame=hand.base_link,
        gripper_axes=f"those of link '{hand.base_link}'; it approaches along "
        f"({join_numbers(hand.approach_axis)})",
        gripper_source=_printable(hand.source),
        gripper_licence=_printable(hand.licence),
        gripper_sha256=_part_digest(hand),
        object=body.name,
        object_file=file,
        object_scale=1.0 if grasps.spec.scale is None else grasps.spec.scale,
        object_frame=OBJECT_FRAMES[frame].format(MESH_FILE if file else MESH_WRITTEN),
        frame=frame,
        object_com=(0.0, 0.0, 0.0) if frame == COM else body.com_in_mesh,
        com_in_mesh=body.com_in_mesh,
        object_mass=body.mass,
        object_friction=body.lateral_friction,
        object_source=_printable(body.source),
        object_licence=_printable(body.licence),
        object_sha256=_part_digest(body),
        collision_parts=body.collision_source,
        quaternions=XYZW,
        protocol=scene.protocol,
        confidence=_confidence(scene),
        scene=bundle,
        runs=runs,
    )


def _confidence(scene: Scene) -> str:
    return (
        f"eta, {ETA_WORDS}; where it is not known fitness / 2"
        if trial_count(scene.protocol)
        else "fitness / 2"
    )


def _source_runs(folder: RunFolder, journal: Journal) -> tuple[SourceRun, ...]:
    if journal.sources:
        return tuple(
            SourceRun(run=source.run, digest=source.digest, spec=_public_spec(source.asked))
            for source in journal.sources
        )
    name = folder.path.absolute().name
    return (SourceRun(run=name, digest=journal_digest(journal), spec=_public_spec(folder.spec)),)


def _public_spec(spec: RunSpec) -> str:
    """A spec as others may read it: it does not tell in which folders the files of its author are."""
    names = {name: Path(getattr(spec, name)).name for name in ("gripper", "object")}
    return to_toml(msgspec.structs.replace(spec, poses=None, **names))


def _part_digest(part: SceneGripper | SceneObject) -> str:
    """The sha256 over the bytes of a part of a scene, as they are in its bundle."""
    values = msgspec.to_builtins(part, builtin_types=(bytes,), order="sorted")
    return hashlib.sha256(msgpack.packb(values, use_bin_type=True)).hexdigest()


def _printable(text: str) -> str:
    """A text without characters that control, which formats have no place for; with its lines."""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")


MATRIX_WORDS = "none: rotations are matrices, columns are the axes of the hand"


def jaw_transforms(grasps: Grasps, about: GraspMetadata) -> Floats:
    """(n, 4, 4): where the turned axes are in the object's frame [m]."""
    return to_matrices(turn_hand_axes(grasps.poses(about.frame), jaw_turn(grasps.scene.gripper)))


def jaw_metadata(about: GraspMetadata, gripper: SceneGripper) -> GraspMetadata:
    """What such a file says of its axes."""
    across = (
        f"x from one finger to the other, along ({join_numbers(gripper.jaw.axis)}) of it"
        if gripper.jaw
        else "x at right angles to it, for the hand has no jaw"
    )
    turn = ", ".join(f"{value:.9g}" for value in jaw_turn(gripper) + 0.0)
    words = (
        f"origin of link '{gripper.base_link}'; +z approaches, along "
        f"({join_numbers(gripper.approach_axis)}) of the "
        f"link; {across}: link axes turned by the quaternion (x, y, z, w) = ({turn})"
    )
    return about.told(axes=words, quaternions=MATRIX_WORDS)
