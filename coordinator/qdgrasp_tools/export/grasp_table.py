"""The table of grasps that each format is written from and read into; its metadata."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import msgspec
import numpy as np
from msgspec import UNSET, Struct, UnsetType
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats, from_frame, multiply, rotate, tangents
from qdgrasp_assets.grippers.gripper_file import OriginalBase
from qdgrasp_assets.regions import regions_at
from qdgrasp_assets.scene import RestingPose, Scene, SceneGripper, SceneObject
from qdgrasp_coordinator.search.fixed_poses import FARTHEST
from qdgrasp_protocol.errors import InputError, UnknownName
from qdgrasp_protocol.spec import DEFAULT_ENGINE, ObjectRecord, RunSpec, from_toml

Frame = Literal["mesh", "com"]
MESH: Frame = "mesh"
COM: Frame = "com"
FRAMES: tuple[Frame, ...] = get_args(Frame)


def frame_of(name: str) -> Frame:
    """Return the object's frame of that name; raises UnknownName."""
    for frame in FRAMES:
        if frame == name:
            return frame
    raise UnknownName("frame", name, FRAMES)


def change_frame(poses: Floats, com_in_mesh: ArrayLike, source: Frame, target: Frame) -> Floats:
    """Move poses (n, 7), xyz [m] and xyzw, or points (n, 3), between frames of the object."""
    found = poses.copy()
    found[:, :3] += (FRAMES.index(source) - FRAMES.index(target)) * np.asarray(com_in_mesh)
    return found


def turn_hand_axes(poses: Floats, rotation: Floats) -> Floats:
    """Turn the hand's own axes of poses (n, 7) by a quaternion (4,), xyzw."""
    rotations = np.broadcast_to(rotation, (len(poses), 4))
    return np.hstack([poses[:, :3], multiply(poses[:, 3:], rotations)])


def to_matrices(poses: Floats) -> Floats:
    """Convert poses (n, 7) to homogeneous matrices (n, 4, 4)."""
    quaternions = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    matrices = np.zeros((len(poses), 4, 4))
    for column, axis in enumerate(np.eye(3)):
        matrices[:, :3, column] = rotate(quaternions, np.broadcast_to(axis, (len(poses), 3)))
    matrices[:, :3, 3], matrices[:, 3, 3] = poses[:, :3], 1.0
    return matrices


def from_matrices(matrices: Floats) -> Floats:
    """Convert homogeneous matrices to poses, the inverse of `to_matrices`, with w >= 0."""
    x, y, z = np.moveaxis(matrices[:, :3, :3], 2, 0)
    return np.hstack([matrices[:, :3, 3], from_frame(x, y, z)])


NEGLIGIBLE = 1e-6  # Component of a unit vector that is taken for zero


def jaw_turn(gripper: SceneGripper) -> Floats:
    """Rotation (4,), xyzw, from a hand's root link to axes with +z toward the object, x across.

    x is the axis along which the two fingers of a jaw open, in the sense whose first component that is not
    zero is positive, or negative if that is y: the Panda's axes are turned by -90 degrees about z, as those
    of ACRONYM and GraspGen are. Of a hand without a jaw it is the first of two tangents to its approach axis
    (`rotation.tangents`), which is its own x if that axis is +z.
    """
    z = np.array([gripper.approach_axis])
    x = tangents(z)[0]
    if gripper.jaw:
        axis = np.array(gripper.jaw.axis)
        x = axis[None] * next(np.sign(each) for each in axis * (1, -1, 1) if abs(each) > NEGLIGIBLE)
    return np.asarray(from_frame(x, np.cross(z, x), z)[0])


def object_mesh(body: SceneObject, frame: Frame) -> Mesh:
    """Return the surface of a scene's object in one of its frames [m]."""
    return body.mesh if frame == COM else body.mesh.moved(body.com_in_mesh)


POSE_WORDS = (
    "close the hand from the commanded pose with the joints before closing (pregrasp); the settled pose goes "
    "with the joints after it"
)
FITNESS_MEANING = (
    "disturbances survived in the nominal evaluation: 0 to 2 shakes, in `physical` 0 to 6 pushes; "
    "higher is better"
)
LIFT_MEANING = "1: the hand lifted the object off the table and held it there; else 0"
UNITS = "m, rad, kg, N"
CONTACT_FIELDS = ("link", "x", "y", "z", "nx", "ny", "nz", "force")
"""Fields of one contact in files: the hand's link, point [m], normal, force [N]."""
MATRIX_WORDS = "none: rotations are matrices, columns are the axes of the hand"


class UnreadableGrasps(InputError):
    """A file that no grasps can be read from; lines of the reason become one."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"No grasps can be read from '{path}': {' '.join(reason.split()).rstrip('.')}.")


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


class RestingPoseRecord(RestingPose, frozen=True, kw_only=True):
    """A resting pose in the frame of the poses."""

    number: int
    """Its number in `qdgrasp asset resting-poses`."""


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
    gripper_sha256: str
    """Digest of its part of a scene bundle."""
    fixed_joints: dict[str, float] = {}
    """Joints of the real hand that stood still, positions [rad or m]; named among the joints."""
    coupling_error: float | UnsetType = UNSET
    """Farthest that a joint which follows another is from its place in these grasps [rad or m]."""
    original_base: OriginalBase | UnsetType = UNSET
    """The base link of the hand's own URDF in `gripper_frame`, where that link was added to the hand.

    A pose of it is a pose of `gripper_frame` times this one.
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
    object_size: tuple[float, float, float]
    """Sides of its bounding box, axes of the mesh [m]."""
    object_mass: float
    """[kg]."""
    object_friction: float
    """Lateral friction coefficient."""
    object_source: str
    object_licence: str
    object_sha256: str
    """Digest of its part of a scene bundle."""
    collision_parts: str
    """Source of the convex parts that were simulated."""
    quaternions: str
    """Order of their components in this file."""
    units: str = UNITS
    protocol: str
    fitness: str = FITNESS_MEANING
    min_fitness: int
    """Least fitness of the grasps that were taken."""
    confidence: str
    """Its meaning, 0 to 1; higher is better."""
    poses: str = POSE_WORDS
    settled: str
    """Whether settled poses and contacts were recorded."""
    approach_distance: float | UnsetType = UNSET
    """Distance from which hands come to the commanded poses [m]; absent: not looked at, as the next one."""
    resting_poses: tuple[RestingPoseRecord, ...] | UnsetType = UNSET
    """Ways in which the object rests on a table, as far as they were looked at; absent: there was none."""
    arm: str | UnsetType = UNSET
    """The arm whose joints the file has, its base and flange, in words; absent: none was asked."""
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


def asset_name(name: str) -> str:
    """Return the name of a gripper or an object, or that of its file."""
    return Path(name).stem if Path(name).suffix else name


def common_values(spec: RunSpec) -> dict[str, str | int]:
    """Return what all grasps of a run have in common, by the names of columns."""
    about = spec.about or ObjectRecord()
    return {
        "object": about.id or asset_name(spec.object),
        "gripper": asset_name(spec.gripper),
        "category": about.category,
        "method": spec.method,
        "seed": spec.seed,
        "protocol": spec.protocol,
        "engine": spec.engine or DEFAULT_ENGINE,
    }


class GraspContacts(NamedTuple):
    """Contacts of n grasps in k slots each; empty slots hold zeros."""

    links: NDArray[np.uint8]
    """(n, k): the hand's link, counted from 1 in `SceneGripper.links`; 0: no contact in this slot."""
    points: Floats
    """(n, k, 3) [m], on the object."""
    normals: Floats
    """(n, k, 3), unit, into the object."""
    forces: Floats
    """(n, k) [N], along the normal."""

    def lists(self, link_names: Sequence[str]) -> list[list[dict[str, Any]]]:
        """Return the contacts of each grasp by `CONTACT_FIELDS`."""
        names = ("", *link_names)
        return [
            [
                dict(zip(CONTACT_FIELDS, (names[link], *point, *normal, force), strict=True))
                for link, point, normal, force in zip(*contacts, strict=True)
                if link
            ]
            for contacts in zip(*(each.tolist() for each in self), strict=True)
        ]


class GraspColumn(NamedTuple):
    """One column of values with a line for each grasp."""

    name: str
    values: NDArray[Any]
    """(n,): numbers, NaN where one is missing, or words, empty where one is missing; see `arrow_table`."""
    meaning: str


def xyz_columns(begin: str, vectors: Floats, meaning: str) -> Iterator[GraspColumn]:
    """Yield the components of vectors (n, 3) as columns whose names begin alike."""
    for name, values in zip("xyz", vectors.T, strict=True):
        yield GraspColumn(f"{begin}{name}", values, meaning)


def region_columns(
    scene: Scene, contacts: GraspContacts, is_known: NDArray[np.bool_]
) -> Iterator[GraspColumn]:
    """Yield a column of the region that each contact is in, "" in none, if a scene has regions.

    `contacts` are in the mesh file's frame; None where they are not known (n,).
    """
    if scene.regions:
        is_there = contacts.links > 0
        names = iter(regions_at(scene, contacts.points[is_there]))
        lists = np.empty(len(is_there), dtype=object)
        lists[:] = [list(islice(names, int(count))) for count in is_there.sum(axis=1)]
        lists[~is_known] = None
        yield GraspColumn(REGION_COLUMN, lists, "the region of the object that each contact is in")


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspTable:
    """Grasps of a hand on an object as a file has them, n lines; None: the file does not say it."""

    names: NDArray[np.str_]
    """(n,): of grasps of ours the rows' numbers in the journal."""
    poses: Floats
    """(n, 7): the commanded pose of the hand, x y z [m] and quaternion xyzw, in the object's frame."""
    has_jaw_axes: bool = False
    """True: the hand's axes are +z toward the object and x across the jaw, not its root link's."""
    frame: Frame | None = None
    """The object's frame that poses are given in."""
    gripper: str | None = None
    link: str | None = None
    """The hand's link that has the poses."""
    joint_names: tuple[str, ...] = ()
    pregrasp: NDArray[np.floating] | None = None
    """(n, j): joints that hands start from [rad or m], NaN where one is unknown."""
    synergies: NDArray[np.str_] | None = None
    """(n,): the synergy that closes the hand, empty where all driven joints do."""
    confidence: Floats | None = None
    scale: float | None = None
    """Factor of the lengths of the object's mesh."""
    mass: float | None = None
    """Mass of the object [kg]."""
    friction: float | None = None
    """Lateral friction coefficient of the object."""
    metadata: GraspMetadata | None = None
    """Metadata of a file of ours."""

    def __len__(self) -> int:
        return len(self.poses)

    def with_metadata(self, about: GraspMetadata) -> "GraspTable":
        """Return the table of a file of ours, with its metadata and only joints that move."""
        moves = np.array([name not in about.fixed_joints for name in self.joint_names], dtype=bool)
        return replace(
            self,
            joint_names=tuple(np.array(self.joint_names, dtype=str)[moves].tolist()),
            pregrasp=None if self.pregrasp is None else self.pregrasp[:, moves],
            frame=about.frame,
            gripper=about.gripper,
            link=about.gripper_frame,
            scale=about.object_scale,
            metadata=about,
        )


PREGRASP = "pregrasp."  # Prefix of columns of joints before closing; the joint's name follows
POSE_COLUMN = "base_to_object"
CONTACTS_MEANING = "contacts after closing: the hand's link, point on the object [m], normal, force [N]"
REGION_COLUMN = "contact_regions"
POSE_MEANING = "the pose as simulated: x y z [m] qx qy qz qw, centre-of-mass frame"


def arrow_table(columns: dict[str, GraspColumn], metadata: dict[str, str] | None = None) -> Any:
    """Return columns as a table of Arrow, with this metadata in its schema; NaN and "" are null."""
    import pyarrow as pa

    contact = pa.struct([(name, pa.float32() if name != "link" else pa.string()) for name in CONTACT_FIELDS])

    def array(name: str, values: NDArray[np.generic]) -> Any:
        if values.dtype.kind == "O":
            return pa.array(values.tolist(), pa.list_(pa.string() if name == REGION_COLUMN else contact))
        if values.dtype.kind == "U":
            return pa.array(values.tolist(), pa.string(), mask=values == "")
        if values.ndim > 1:
            none = pa.array(np.isnan(values).any(axis=1))
            return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1], mask=none)
        return pa.array(np.ascontiguousarray(values), mask=np.isnan(values))

    arrays = {name: array(name, column.values) for name, column in columns.items()}
    fields = [
        pa.field(name, arrays[name].type, metadata={"meaning": column.meaning})
        for name, column in columns.items()
    ]
    return pa.table(list(arrays.values()), schema=pa.schema(fields, metadata=metadata))


def exact_decimals(values: NDArray[np.floating]) -> Floats:
    """Return numbers as float64 with the shortest decimals of their own precision."""
    return np.asarray(values, dtype="U32").astype(np.float64)


def plain_values(values: NDArray[Any]) -> list[Any]:
    """Return values (n,) of a column as plain ones; None for NaN."""
    if values.ndim > 1:
        return ["" if np.isnan(line).any() else " ".join(map(str, line)) for line in values.tolist()]
    if values.dtype.kind != "f":
        return list(values.tolist())
    return [None if value != value else value for value in exact_decimals(values).tolist()]


UNIT_TOLERANCE = 1e-2
"""Tolerance of a quaternion's length, and of a matrix's products from the identity."""


def check_table(path: Path, table: GraspTable) -> None:
    """Check that there are grasps, and that their numbers are possible; raises UnreadableGrasps."""
    if not len(table):
        raise UnreadableGrasps(path, "there is none in it")
    columns = {
        "names": table.names, "synergies": table.synergies, "confidence": table.confidence,
        "joints": table.pregrasp,
    }  # fmt: skip
    for what, values in columns.items():
        if values is not None and len(values) != len(table):
            raise UnreadableGrasps(path, f"it has {len(table)} poses, and {len(values)} of its {what}")
    check_positions(path, table.names, table.poses)
    lengths = np.linalg.norm(table.poses[:, 3:], axis=1)
    _check_each(
        path, table.names, np.abs(lengths - 1.0) <= UNIT_TOLERANCE, "its quaternion is not a unit one"
    )
    if table.pregrasp is not None:
        _check_each(path, table.names, ~np.isinf(table.pregrasp).any(axis=1), "a joint of it is infinite")


def check_positions(path: Path, names: NDArray[np.str_], poses: Floats) -> None:
    """Check that poses (n, 7) are finite, and near enough for their digits to mean something."""
    _check_each(path, names, np.isfinite(poses).all(axis=1), "its pose holds a number that is not finite")
    near = (np.abs(poses[:, :3]) <= FARTHEST).all(axis=1)
    _check_each(path, names, near, f"its position is more than {FARTHEST:g} m away; lengths are metres")


def check_matrices(path: Path, matrices: Floats) -> Floats:
    """Check that an array is of homogeneous matrices (n, 4, 4) of rigid motions, and return it."""
    if matrices.shape[1:] != (4, 4):
        raise UnreadableGrasps(path, "its transforms must be of shape (n, 4, 4)")
    turns = matrices[:, :3, :3]
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    is_rigid = (off <= UNIT_TOLERANCE) & (np.linalg.det(turns) > 0)
    is_rigid &= (matrices[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    names = np.arange(len(matrices)).astype(str)
    _check_each(path, names, is_rigid, "its transform is not a rotation and a translation")
    return matrices


def _check_each(path: Path, names: NDArray[np.str_], good: Any, what: str) -> None:
    if not np.all(good):
        raise UnreadableGrasps(path, f"of grasp '{names[~good][0]}' {what}")
