"""The scene: one gripper, one object and one evaluation protocol, with all that a worker needs of them.

A scene is frozen and content-addressed: its canonical MessagePack bytes are the bundle that workers fetch
over the bus, and their sha256 is its name. Lengths are metres, masses kg, angles rad, quaternions xyzw.
"""

import hashlib
from dataclasses import dataclass

import msgpack
import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.genome import GIVEN, Gene, Layout

Vector = tuple[float, float, float]


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
    """Closes with the hand, in the synergies that name it; False: never commanded, held by Bullet's motor."""


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
    """What holds it in place [N or Nm]."""
    max_velocity: float
    shake_force: float = 0.0
    """What moves it in its shake [N or Nm]."""
    shake: str = ""
    """"z" or "x" for the joint that the translation or rotation shake moves, else empty."""


class SceneGripper(Struct, frozen=True, kw_only=True):
    """A hand on its carrier."""

    name: str
    source: str
    """Where it came from: "built in", "asset path" or a file's name."""
    licence: str
    urdf: str
    """The URDF, carrier in front; at carrier zero its root link coincides with the hand's base link."""
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
    """From the base frame to the palm along the approach axis (w) [m]."""
    standoff: tuple[float, float]
    """The range of the gene d: from the palm to the surface point [m]."""


class SceneObject(Struct, frozen=True, kw_only=True):
    """A rigid object. Geometry is in the centre-of-mass frame: origin at the CoM, axes of the mesh."""

    name: str
    source: str
    licence: str
    collision_source: str
    """Where the convex parts came from: "own parts", "own hull", "asset path" or "coacd"."""
    mass: float
    lateral_friction: float
    rolling_friction: float
    spinning_friction: float
    com_in_mesh: Vector
    """The centre of mass in the mesh file's frame [m]: mesh = com frame + this."""
    collision: bytes
    """The convex parts as one OBJ file, one `o` group each, CoM frame."""
    mesh_vertices: bytes
    """The surface mesh for drawing and geometry, float32 (v, 3), CoM frame."""
    mesh_faces: bytes
    """uint32 (f, 3), outward winding."""


class Scene(Struct, frozen=True, kw_only=True):
    """What a worker needs to evaluate genomes."""

    format: int = 1
    protocol: str
    gripper: SceneGripper
    object: SceneObject
    points: bytes
    """Surface points S_c, float32 (n, 3), CoM frame."""
    normals: bytes
    """Their outward unit normals, float32 (n, 3)."""
    finder_low: Vector
    """The box of the contact point finder, CoM frame."""
    finder_high: Vector
    object_low: Vector
    """The object's own axis-aligned bounding box, CoM frame."""
    object_high: Vector

    @property
    def surface_points(self) -> NDArray[np.float32]:
        """(n, 3) [m], CoM frame."""
        return np.frombuffer(self.points, dtype="<f4").reshape(-1, 3)

    @property
    def surface_normals(self) -> NDArray[np.float32]:
        """(n, 3), unit, outward, CoM frame."""
        return np.frombuffer(self.normals, dtype="<f4").reshape(-1, 3)

    @property
    def reach(self) -> float:
        """The farthest that the base frame can be from a surface point [m]."""
        return self.gripper.palm_offset + self.gripper.standoff[1]

    @property
    def archive_box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Low and high corner of the box of hand positions: the object's box enlarged by the reach."""
        return np.array(self.object_low) - self.reach, np.array(self.object_high) + self.reach


PRIOR_CONE = {"contact": np.pi, "approach": np.pi / 4}
"""nu_a by prior: contact is approach with nu_a = pi (Huber et al. 2024, section III-A)."""


def layout(scene: Scene, prior: str) -> Layout:
    """The genes that a prior has with this scene: the prior's own, then the synergy, then the free joints.

    theta = (x_r, y_r, z_r, nu, d, xi, omega), Huber et al. 2024, eq. 2. The synergy gene maps to
    round(values) in 0 .. m - 1. Poses that are scored as given have x y z [m], qx qy qz qw first, then the
    synergy's label (-1: none) and the free joints' positions [rad], all as they are.
    """
    gripper = scene.gripper
    extra = [Gene("synergy", 0.0, len(gripper.synergies) - 1.0)] if gripper.synergies else []
    extra += [Gene(joint.name, joint.low, joint.high) for joint in gripper.free_joints]
    if prior == GIVEN:
        own = [Gene(name, -1.0, 1.0) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    else:
        finder = zip("xyz", scene.finder_low, scene.finder_high, strict=True)
        own = [Gene(f"{axis}_r", low, high) for axis, low, high in finder]
        own += [
            Gene("nu", 0.0, PRIOR_CONE[prior]),
            Gene("d", *gripper.standoff),
            Gene("xi", 0.0, 2 * np.pi),
            Gene("omega", 0.0, 2 * np.pi),
        ]
    return Layout(prior, tuple(own + extra))


@dataclass(frozen=True)
class Bundle:
    """A scene as bytes, with its name."""

    payload: bytes
    digest: str


def pack_scene(scene: Scene) -> Bundle:
    """The canonical bytes of a scene and their sha256."""
    values = msgspec.to_builtins(scene, builtin_types=(bytes,), order="sorted")
    payload = bytes(msgpack.packb(values, use_bin_type=True))
    return Bundle(payload, hashlib.sha256(payload).hexdigest())


def unpack_scene(payload: bytes) -> Scene:
    """The scene in a bundle.

    Raises
    ------
    MessageError
        These bytes are not a scene of this format.
    """
    try:
        return msgspec.convert(msgpack.unpackb(payload, max_ext_len=0), Scene)
    except (ValueError, msgpack.UnpackException, msgspec.ValidationError) as error:
        raise MessageError(f"not a scene bundle: {error}") from None
