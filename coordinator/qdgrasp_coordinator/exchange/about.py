"""What every file of grasps says of itself: frames, units, success, licences, and where it came from."""

import hashlib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgpack
import msgspec
from msgspec import Struct

from qdgrasp_assets.scene import Scene, SceneGripper, SceneObject
from qdgrasp_coordinator.exchange.frames import COM, Frame
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.folders.digest import digest
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.phrases import plain
from qdgrasp_protocol.spec import RunSpec, from_toml, to_toml
from qdgrasp_protocol.trials import trials

SUCCESS = "a finger touches the object after closing"
GRASP = "a success that survives at least one of the two shakes: fitness 1 or 2"
FITNESS = "shakes survived in the nominal evaluation: 0, 1 or 2; higher is better"
ETA = (
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


class FoundBy(Struct, frozen=True, kw_only=True):
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


class About(Struct, frozen=True, kw_only=True):
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
    success: str = SUCCESS
    grasp: str = GRASP
    fitness: str = FITNESS
    confidence: str
    """What it is, 0 to 1; higher is better."""
    scene: str
    """sha256 of the scene bundle."""
    runs: tuple[FoundBy, ...]

    @property
    def values(self) -> dict[str, Any]:
        """As plain values."""
        values: dict[str, Any] = msgspec.to_builtins(self)
        return values

    @property
    def json(self) -> str:
        """As one JSON object."""
        return msgspec.json.encode(self).decode()

    def told(self, *, axes: str | None = None, quaternions: str | None = None) -> "About":
        """The same for a file with these axes of the hand, and this order of quaternions."""
        changed = {"gripper_axes": axes, "quaternions": quaternions}
        return msgspec.structs.replace(self, **{name: told for name, told in changed.items() if told})


def about(folder: RunFolder, grasps: Grasps, frame: Frame) -> About:
    """What a file of grasps from a run's folder says, told in a frame of the object."""
    scene = grasps.scene
    hand, body = scene.gripper, scene.object
    file = Path(grasps.spec.object).name if Path(grasps.spec.object).suffix else ""
    with folder.journal() as journal:
        runs, bundle = _origins(folder, journal), journal.scene
    return About(
        qdgrasp=version("qdgrasp"),
        gripper=hand.name,
        gripper_frame=hand.base_link,
        gripper_axes=f"those of link '{hand.base_link}'; it approaches along ({plain(hand.approach_axis)})",
        gripper_source=_plain(hand.source),
        gripper_licence=_plain(hand.licence),
        gripper_sha256=_digest(hand),
        object=body.name,
        object_file=file,
        object_scale=1.0 if grasps.spec.scale is None else grasps.spec.scale,
        object_frame=OBJECT_FRAMES[frame].format(MESH_FILE if file else MESH_WRITTEN),
        frame=frame,
        object_com=(0.0, 0.0, 0.0) if frame == COM else body.com_in_mesh,
        com_in_mesh=body.com_in_mesh,
        object_mass=body.mass,
        object_friction=body.lateral_friction,
        object_source=_plain(body.source),
        object_licence=_plain(body.licence),
        object_sha256=_digest(body),
        collision_parts=body.collision_source,
        quaternions=XYZW,
        protocol=scene.protocol,
        confidence=_confidence(scene),
        scene=bundle,
        runs=runs,
    )


def _confidence(scene: Scene) -> str:
    return f"eta, {ETA}; where it is not known fitness / 2" if trials(scene.protocol) else "fitness / 2"


def _origins(folder: RunFolder, journal: Journal) -> tuple[FoundBy, ...]:
    if journal.sources:
        return tuple(
            FoundBy(run=source.run, digest=source.digest, spec=_toml(source.asked))
            for source in journal.sources
        )
    name = folder.path.absolute().name
    return (FoundBy(run=name, digest=digest(journal), spec=_toml(folder.spec)),)


def _toml(spec: RunSpec) -> str:
    """A spec as others may read it: it does not tell in which folders the files of its author are."""
    names = {name: Path(getattr(spec, name)).name for name in ("gripper", "object")}
    return to_toml(msgspec.structs.replace(spec, poses=None, **names))


def _digest(part: SceneGripper | SceneObject) -> str:
    """The sha256 over the bytes of a part of a scene, as they are in its bundle."""
    values = msgspec.to_builtins(part, builtin_types=(bytes,), order="sorted")
    return hashlib.sha256(msgpack.packb(values, use_bin_type=True)).hexdigest()


def _plain(text: str) -> str:
    """A text without characters that control, which formats have no place for; with its lines."""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")
