"""The scene: one gripper, one object, one evaluation protocol; all that a worker needs.

A scene is frozen and content-addressed: its canonical MessagePack bytes are the bundle that workers fetch
over the bus, and their sha256 is its name. Lengths are metres, masses kg, angles rad, quaternions xyzw.
"""

import hashlib
from dataclasses import dataclass
from typing import Annotated

import msgpack
import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_protocol.errors import MessageError

Vector = tuple[float, float, float]
Words = Annotated[str, Meta(max_length=1000)]

FORMAT = 3  # Version of the bundle, raised when a field comes, goes or changes its meaning
NEWER_FORMAT = 4  # Version for scenes that name an engine, or whose trials disturb `physical`
LATER_FIELDS = {
    NEWER_FORMAT: ("engine",),
    5: ("approach_distance", "resting_poses"),
    6: ("neighbours",),
    8: ("regions",),
}
"""Versions for scenes with fields that others leave out, by version."""
FORMATS = (FORMAT, *LATER_FIELDS)
BORDER = 1e-3  # Distance along the surface that contacts keep from the border of what is allowed [m]


class Joint(Struct, frozen=True, kw_only=True):
    """One finger joint that moves in an evaluation or is held."""

    name: str
    opened: float
    """Position in the open posture [rad or m]."""
    closed: float
    """Target when the hand closes."""
    effort: float
    """Motor force [N or Nm]."""
    velocity: float
    """Motor velocity limit [m/s or rad/s]."""
    driven: bool = True
    """True: closes in the synergies that name it; False: held by Bullet's own motor."""
    rated_effort: float = 0.0
    """Greatest force or torque of the real drive at this joint [N or Nm]; 0: not stated."""
    rated_velocity: float = 0.0
    """Speed at which the real hand closes [m/s or rad/s]; 0: not stated."""


class Synergy(Struct, frozen=True, kw_only=True):
    """Joints that close together."""

    name: str
    joints: tuple[str, ...]


class FreeJoint(Struct, frozen=True, kw_only=True):
    """A joint whose initial position is a gene: -1 stands for `low`, +1 for `high`."""

    name: str
    low: float
    high: float


class CarrierJoint(Struct, frozen=True, kw_only=True):
    """A virtual joint between world and hand that a shake moves, or that is held."""

    name: str
    force: float
    """Force that holds it in place [N or Nm]."""
    max_velocity: float
    shake_force: float = 0.0
    """Force that moves it in its shake [N or Nm]."""
    shake: str = ""
    """"z" or "x" for the joint that the translation or rotation shake moves, else empty."""


class Jaw(Struct, frozen=True, kw_only=True):
    """The two opposing fingers of a two-finger hand."""

    axis: Vector
    """Unit vector from one finger to the other, normal to the approach axis, base frame."""
    opening: float
    """Distance between the open fingers [m]."""


class SceneGripper(Struct, frozen=True, kw_only=True):
    """A hand on its carrier."""

    name: str
    source: str
    """Source: "built in", "asset path" or a file's name."""
    licence: str
    urdf: str
    """URDF with the carrier; at carrier zero its root coincides with the hand's base link."""
    meshes: dict[str, bytes]
    """Mesh files by the name that the URDF uses."""
    base_link: str
    """The hand's root link: the frame of `base_to_object`."""
    carrier: tuple[CarrierJoint, ...]
    joints: tuple[Joint, ...]
    finger_links: tuple[str, ...]
    """Links whose contact after closing makes a success."""
    synergies: tuple[Synergy, ...] = ()
    """Empty: all driven joints close."""
    free_joints: tuple[FreeJoint, ...] = ()
    approach_axis: Vector
    """Unit vector in the base frame that points from the palm to the object (a_g)."""
    palm_offset: float
    """Distance from the base frame to the palm along the approach axis (w) [m]."""
    standoff: tuple[float, float]
    """The range of the gene d: from the palm to the surface point [m]."""
    jaw: Jaw | None = None
    """None: not a two-finger hand."""
    extent: float
    """Largest side of the box around its collision shapes, joints at zero, base frame [m]."""
    links: tuple[str, ...] = ()
    """All links from the base link on, in the order in which rows count them."""
    disabled_collisions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that may overlap, besides a joint's parent and child."""

    @property
    def reach(self) -> float:
        """Largest distance of the base frame from the surface point that the palm looks at [m]."""
        return self.palm_offset + self.standoff[1]


class BodyGeometry(Struct, frozen=True, kw_only=True):
    """Mesh and convex parts of an object in its CoM frame: origin at the CoM, axes of the mesh."""

    collision_source: Words
    """Source of the parts: "own parts", "own hull", "asset path" or "cuts"."""
    com_in_mesh: Vector
    """The centre of mass in the mesh file's frame [m]: mesh = com frame + this."""
    collision: bytes
    """The convex parts as one OBJ file, one `o` group each."""
    mesh_vertices: bytes
    """The surface mesh for drawing and geometry, float32 (v, 3)."""
    mesh_faces: bytes
    """uint32 (f, 3), outward winding."""

    @property
    def vertices(self) -> NDArray[np.float32]:
        """(v, 3) [m]: the vertices of the surface mesh, CoM frame."""
        return np.frombuffer(self.mesh_vertices, dtype="<f4").reshape(-1, 3)

    @property
    def triangles(self) -> NDArray[np.float32]:
        """(f, 3, 3) [m]: the corners of the surface mesh's triangles, CoM frame."""
        return np.asarray(self.vertices[self.mesh.faces])

    @property
    def mesh(self) -> Mesh:
        """The surface mesh, CoM frame."""
        faces = np.frombuffer(self.mesh_faces, "<u4").reshape(-1, 3)
        return Mesh(self.vertices.astype(np.float64), faces.astype(np.int64))

    @property
    def radius(self) -> float:
        """Greatest distance of the surface mesh from the centre of mass [m]."""
        return float(np.sqrt((self.vertices.astype(np.float64) ** 2).sum(axis=1).max()))


class SceneObject(BodyGeometry, frozen=True, kw_only=True):
    """A rigid object."""

    name: str
    source: str
    licence: str
    mass: float
    lateral_friction: float
    rolling_friction: float
    spinning_friction: float


class SurfacePoints(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The surface points of an object and the boxes about it, CoM frame."""

    points: bytes
    """Surface points S_c, float32 (n, 3)."""
    normals: bytes
    """Their outward unit normals, float32 (n, 3)."""
    finder_low: Vector
    """The box of the contact point finder."""
    finder_high: Vector
    object_low: Vector
    """The object's own axis-aligned bounding box."""
    object_high: Vector

    @property
    def surface_points(self) -> NDArray[np.float32]:
        """(n, 3) [m], CoM frame."""
        return np.frombuffer(self.points, dtype="<f4").reshape(-1, 3)

    @property
    def surface_normals(self) -> NDArray[np.float32]:
        """(n, 3), unit, outward, CoM frame."""
        return np.frombuffer(self.normals, dtype="<f4").reshape(-1, 3)


class RestingPose(Struct, frozen=True, kw_only=True):
    """A way in which an object rests on a table, which is a plane; CoM frame."""

    up: Vector
    """Unit vector, to six decimals, away from the table and at right angles to it."""
    height: float
    """Component along `up` of the table's points [m], six decimals; negative."""
    probability: float
    """Probability that an object that is dropped, turned in any way, comes to rest so."""


class Region(Struct, frozen=True, kw_only=True):
    """A part of an object's surface that a spec names."""

    name: str
    """Its name or numbers there, or the name of its file without folders."""
    mask: bytes
    """Bits of points sampled on the mesh, in the order of `sample_surface` with seed 0: 1 in the region."""
    is_allowed: bool
    """True: contacts are in one of these; False: in none."""


class Scene(SurfacePoints, frozen=True, kw_only=True, forbid_unknown_fields=False):
    """All that a worker needs to evaluate genomes."""

    format: int = FORMAT
    protocol: str
    base: str = "paper"
    """The protocol that the trials of `robust` disturb."""
    engine: str | None = None
    """The physics engine, or two in their order, as "bullet,mujoco"; None: Bullet."""
    gripper: SceneGripper
    object: SceneObject
    contact_slots: int = 0
    """Contacts that a row has room for; 0: rows have no columns of the closed hand."""
    approach_distance: float = 0.0
    """Distance from which the open hand has to come along its approach axis, clear of the object [m]."""
    resting_poses: tuple[RestingPose, ...] = ()
    """Resting poses, in one of which the hand has to come above the table; none: there is no table."""
    neighbours: bytes = b""
    """Convex parts of the fixed bodies around the object, as one OBJ file, CoM frame; empty: none."""
    regions: tuple[Region, ...] = ()
    """The places that contacts have to be on, or must not be on; none: anywhere."""


@dataclass(frozen=True)
class Bundle:
    """A scene as bytes, with the sha256 that is its name."""

    payload: bytes
    digest: str


def pack_scene(scene: Scene) -> Bundle:
    """Return the canonical bytes of a scene and their sha256."""
    values = msgspec.to_builtins(scene, builtin_types=(bytes,), order="sorted")
    values["format"] = NEWER_FORMAT if scene.base == "physical" else FORMAT
    for number, names in LATER_FIELDS.items():
        if any(values[name] for name in names):
            values["format"] = max(number, values["format"])
        else:
            for name in names:
                del values[name]
    payload = bytes(msgpack.packb(values, use_bin_type=True))
    return Bundle(payload, hashlib.sha256(payload).hexdigest())


def unpack_scene(payload: bytes) -> Scene:
    """Return the scene in a bundle; `MessageError` if the bytes are not a scene of this format."""
    try:
        values = msgpack.unpackb(payload, max_ext_len=0)
        came = values.get("format") if isinstance(values, dict) else None
        if came not in FORMATS:
            known = " and ".join(map(str, FORMATS))
            raise MessageError(f"it is of format {came}, this version of qdgrasp reads the formats {known}")
        return msgspec.convert(values, Scene)
    except (ValueError, msgpack.UnpackException, msgspec.ValidationError) as error:
        raise MessageError(f"not a scene bundle: {error}") from None


def vector(values: Floats) -> Vector:
    """Return three numbers as plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def unit_vector(axis: Vector) -> Vector:
    """Return a direction scaled to length 1."""
    return vector(np.array(axis) / np.linalg.norm(axis))
