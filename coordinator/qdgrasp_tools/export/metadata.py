"""Metadata of a file of grasps: frames, units, success, licences, source runs."""

import hashlib
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack
import msgspec
import numpy as np
from msgspec import UNSET, Struct, UnsetType

from qdgrasp_assets.geometry.rotation import Floats, running_sum
from qdgrasp_assets.grippers.gripper_file import OriginalBase
from qdgrasp_assets.scene import SceneGripper, SceneObject, Vector, vector
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_protocol.rows import LIFT
from qdgrasp_protocol.spec import RunSpec, from_toml, to_toml
from qdgrasp_protocol.text import join_numbers
from qdgrasp_tools.export.frames import (
    COM,
    Frame,
    jaw_turn,
    scene_original_base,
    to_matrices,
    turn_hand_axes,
)
from qdgrasp_tools.export.grasp_reader import ChosenGrasps
from qdgrasp_tools.export.grasp_set import Grasps

if TYPE_CHECKING:
    from qdgrasp_assets.grippers.reachability import ReachabilityCheck

SUCCESS_WORDS = "a finger touches the object after closing"
GRASP_WORDS = "a success that survives at least one disturbance: fitness 1 or more"
FITNESS_MEANING = (
    "disturbances survived in the nominal evaluation: 0 to 2 shakes, in `physical` 0 to 6 pushes; "
    "higher is better"
)
LIFT_MEANING = "1: the hand lifted the object off the table and held it there; else 0"
ETA_WORDS = (
    "the share of disturbances survived in all trials with disturbed pose and friction, "
    "the estimated probability of transfer"
)
MESH_FILE = "the mesh file"
MESH_WRITTEN = "the mesh that `qdgrasp export --format graspgen --frame mesh` writes"
"""Mesh of an object that is built in or from the asset path."""
OBJECT_FRAMES: dict[Frame, str] = {
    "mesh": "that of {}: its origin and axes, its lengths times object_scale",
    "com": "origin at the centre of mass, axes of {}",
}
UNITS = "m, rad, kg, N"
PREGRASP_WORDS = "the commanded pose with open joints, before closing"
SETTLED_WORDS = "the settled pose with the joints after closing"
CONTACT_WORDS = "after closing: point on the object, unit normal into it, force along the normal"
NOT_SETTLED = "this run was recorded before settled poses were; the grasp pose is the commanded one"
XYZW = "x, y, z, w"
MICROMETRE = 6  # Decimals of a length [m]


class SourceRun(Struct, frozen=True, kw_only=True):
    """A run that found grasps of a file."""

    run: str
    """The name of its folder."""
    digest: str
    """The sha256 over its rows, as `qdgrasp digest` prints it; of a run in progress by now."""
    spec: str
    """Its spec as TOML, without folders of its files and without given poses."""

    @property
    def asked(self) -> RunSpec:
        """The spec as it was asked for."""
        return from_toml(self.spec, self.run)


class RestingPoseRecord(Struct, frozen=True, kw_only=True):
    """A way in which the object rests on a table."""

    number: int
    """Its number in `qdgrasp asset resting-poses`."""
    up: tuple[float, float, float]
    """Unit vector in the object's frame that points away from the table."""
    height: float
    """Component along `up` of the table's points, in the frame of the poses [m]."""
    probability: float


class GraspMetadata(Struct, frozen=True, kw_only=True):
    """Metadata of a file of grasps. Lengths are metres."""

    qdgrasp: str
    """The version that wrote it."""
    gripper: str
    gripper_frame: str
    """The hand's link that has the poses."""
    gripper_axes: str
    """Orientation of the pose's axes on that link."""
    gripper_source: str
    """"built in", "asset path" or a file's name."""
    gripper_licence: str
    gripper_sha256: str = ""
    """Digest of its part of a scene bundle; empty in a file of an earlier version."""
    original_base: OriginalBase | UnsetType = UNSET
    """The base link of the hand's own URDF in `gripper_frame`, where that link was added to the hand.

    A pose of it is a pose of `gripper_frame` times this one (`frames.original_base_poses`).
    """
    object: str
    object_file: str
    """The mesh file's name; empty for an object that is built in or from the asset path."""
    object_scale: float
    """Factor of the lengths in the mesh file, to metres."""
    object_frame: str
    """Meaning of `frame` in words."""
    frame: Frame
    object_com: tuple[float, float, float]
    """The centre of mass in that frame [m]."""
    com_in_mesh: tuple[float, float, float]
    """The centre of mass in the frame of the mesh [m]: mesh = com + this."""
    object_size: tuple[float, float, float] | None = None
    """Sides of its bounding box, axes of the mesh [m]; None in a file of an earlier version."""
    object_mass: float
    """[kg]."""
    object_friction: float
    """Lateral friction coefficient."""
    object_source: str
    object_licence: str
    object_sha256: str = ""
    """Digest of its part of a scene bundle; empty in a file of an earlier version."""
    collision_parts: str
    """Source of the convex parts that were simulated."""
    quaternions: str
    """Order of their components in this file."""
    units: str = UNITS
    protocol: str
    success: str = SUCCESS_WORDS
    grasp: str = GRASP_WORDS
    fitness: str = FITNESS_MEANING
    min_fitness: int | UnsetType = UNSET
    """Least fitness of the grasps that were taken; absent in a file of an earlier version."""
    confidence: str
    """Its meaning, 0 to 1; higher is better."""
    pregrasp_pose: str = ""
    """Place of the commanded poses with open joints; this and the next three are empty in earlier files."""
    grasp_pose: str = ""
    """Place of the settled poses with the joints after closing."""
    contacts: str = ""
    """Place and meaning of the contacts."""
    settled: str = ""
    """Whether settled poses and contacts were recorded."""
    approach_distance: float | UnsetType = UNSET
    """Distance from which hands come to the commanded poses [m]; absent: not looked at, as the next one."""
    resting_poses: tuple[RestingPoseRecord, ...] | UnsetType = UNSET
    """Ways in which the object rests on a table, as far as they were looked at; absent: there was none."""
    scene: str
    """sha256 of the scene bundle."""
    runs: tuple[SourceRun, ...]

    @property
    def values(self) -> dict[str, Any]:
        """The fields as plain values."""
        return dict(msgspec.to_builtins(self))

    @property
    def json(self) -> str:
        """The fields as one JSON object."""
        return msgspec.json.encode(self).decode()


@dataclass(frozen=True)
class PosePlaces:
    """Places of the two poses and the contacts in a format."""

    pregrasp: str
    grasp: str
    contacts: str = ""
    """Empty: the format has no place for them."""


def settled_words(grasps: Grasps | ChosenGrasps) -> str:
    """Say of how many successes the settled pose was recorded."""
    known, successes = np.count_nonzero(grasps.is_settled), np.count_nonzero(grasps.is_success)
    if not known:
        return NOT_SETTLED
    if known == successes:
        return "recorded of every success"
    return f"recorded of {known} of {successes} successes; the grasp pose of the others is the commanded one"


def grasp_metadata(
    folder: RunFolder, grasps: Grasps | ChosenGrasps, frame: Frame, places: PosePlaces
) -> GraspMetadata:
    """Make the metadata of a file of grasps from a run's folder, in a frame of the object."""
    scene = grasps.scene
    hand, body = scene.gripper, scene.object
    file = Path(grasps.spec.object).name if Path(grasps.spec.object).suffix else ""
    check, origin = grasps.approach, (0.0, 0.0, 0.0) if frame == COM else body.com_in_mesh
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
        gripper_sha256=part_digest(hand),
        original_base=scene_original_base(hand) or UNSET,
        object=body.name,
        object_file=file,
        object_scale=1.0 if grasps.spec.scale is None else grasps.spec.scale,
        object_frame=OBJECT_FRAMES[frame].format(MESH_FILE if file else MESH_WRITTEN),
        frame=frame,
        object_com=origin,
        com_in_mesh=body.com_in_mesh,
        object_size=vector(np.subtract(scene.object_high, scene.object_low).round(MICROMETRE)),
        object_mass=body.mass,
        object_friction=body.lateral_friction,
        object_source=_printable(body.source),
        object_licence=_printable(body.licence),
        object_sha256=part_digest(body),
        collision_parts=body.collision_source,
        quaternions=XYZW,
        protocol=scene.protocol,
        fitness=LIFT_MEANING if scene.protocol == LIFT else FITNESS_MEANING,
        min_fitness=grasps.min_fitness if isinstance(grasps, ChosenGrasps) else UNSET,
        confidence=_confidence_words(grasps.spec),
        pregrasp_pose=f"{PREGRASP_WORDS}: {places.pregrasp}",
        grasp_pose=f"{SETTLED_WORDS}: {places.grasp}",
        contacts=f"{CONTACT_WORDS}: {places.contacts}" if places.contacts else "not in this format",
        settled=settled_words(grasps),
        approach_distance=UNSET if check is None else check.distance,
        resting_poses=_resting_poses(check, origin) if check and check.poses else UNSET,
        scene=bundle,
        runs=runs,
    )


def _resting_poses(check: "ReachabilityCheck", origin: Vector) -> tuple[RestingPoseRecord, ...]:
    """Return resting poses in a frame in which the centre of mass is at `origin` [m]."""
    return tuple(
        RestingPoseRecord(
            number=number,
            up=pose.up,
            height=round(pose.height + running_sum(a * b for a, b in zip(pose.up, origin, strict=True)), 6),
            probability=pose.probability,
        )
        for number, pose in check.poses.items()
    )


def _confidence_words(spec: RunSpec) -> str:
    share = f"fitness / {spec.disturbances}"
    if not spec.trial_count:
        return share
    base = "" if spec.base == "paper" else f" under {spec.base}"
    return f"eta{base} of {spec.trial_count} trials, {ETA_WORDS}; where it is not known {share}"


def _source_runs(folder: RunFolder, journal: Journal) -> tuple[SourceRun, ...]:
    name = folder.path.absolute().name
    return (SourceRun(run=name, digest=journal_digest(journal), spec=_public_spec(folder.spec)),)


def _public_spec(spec: RunSpec) -> str:
    """Write a spec without the folders of its author's files, and without poses."""
    names = {name: Path(getattr(spec, name)).name for name in ("gripper", "object")}
    return to_toml(msgspec.structs.replace(spec, poses=None, **names))


def part_digest(part: SceneGripper | SceneObject) -> str:
    """Return the sha256 over the bytes of a part of a scene, as they are in its bundle."""
    values = msgspec.to_builtins(part, builtin_types=(bytes,), order="sorted")
    return hashlib.sha256(msgpack.packb(values, use_bin_type=True)).hexdigest()


def _printable(text: str) -> str:
    """Remove control characters, which formats have no place for; lines stay."""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")


MATRIX_WORDS = "none: rotations are matrices, columns are the axes of the hand"


def jaw_transforms(poses: Floats, gripper: SceneGripper) -> Floats:
    """(n, 4, 4): the turned axes of a hand whose root link has poses (n, 7) [m]."""
    return to_matrices(turn_hand_axes(poses, jaw_turn(gripper)))


def settled_jaw_transforms(grasps: Grasps, frame: Frame) -> Floats:
    """(n, 4, 4): the same of settled poses in the object's frame; NaN where none was recorded."""
    transforms = jaw_transforms(grasps.settled_poses(frame), grasps.scene.gripper)
    transforms[~grasps.is_settled] = np.nan
    return transforms


def jaw_metadata(metadata: GraspMetadata, gripper: SceneGripper) -> GraspMetadata:
    """Describe the turned axes in the metadata."""
    across = (
        f"x from one finger to the other, along ({join_numbers(gripper.jaw.axis)}) of it"
        if gripper.jaw
        else "x at right angles to it, for the hand has no jaw"
    )
    turn = ", ".join(f"{value:.9g}" for value in jaw_turn(gripper) + 0.0)
    words = (
        f"origin of link '{gripper.base_link}'; +z approaches, along ({join_numbers(gripper.approach_axis)}) "
        f"of the link; {across}: link axes turned by the quaternion (x, y, z, w) = ({turn})"
    )
    return msgspec.structs.replace(metadata, gripper_axes=words, quaternions=MATRIX_WORDS)
