"""NumPy files for DexGraspBench, MolmoSpaces and cuRobo.

DexGraspBench (JYChen18/DexGraspBench, main of June 2025; BODex's data too): the evaluator reads each `.npy`
below a folder, a pickled dict of one grasp: `pregrasp_qpos`, `grasp_qpos` and `squeeze_qpos`
(7 + j,), position [m] and quaternion wxyz of the root of the hand's MJCF and its joints in that order;
`obj_pose` (7,) alike; `obj_scale`; `obj_path`, a folder with convex parts and `info/simplified.json`. The
hand moves from the first to the others. All have the settled pose, the first with fingers a little
open: from the commanded pose linear motion pushes the object away. It is at the origin.

MolmoSpaces (allenai/molmospaces, August 2026): a library has `OBJECT/ROBOT/grasps.npz` with `transforms`
(n, 4, 4), the frame between the open fingertips in that of the object, +z forward, fingers along y.

cuRobo (NVlabs/curobo 0.8.0) reads no file of grasps: `plan_grasp` takes a `GoalToolPose` of `tool_frames`,
`position` (1, 1, 1, n, 3) [m] and `quaternion` (1, 1, 1, n, 4), wxyz, which the file has for the root link.
"""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import parse_parts, parts_to_obj
from qdgrasp_assets.geometry.rotation import from_frame, tangents
from qdgrasp_assets.scene import SceneObject
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import GraspMetadata, from_matrices, object_mesh, to_matrices
from qdgrasp_tools.export.scene_mjcf import closing_speeds, replay_files

HALF, NO_TURN = 0.5**0.5, (0, 0, 0, 0, 0, 0, 1)
SHADOW = "FFJ4 FFJ3 FFJ2 FFJ1 MFJ4 MFJ3 MFJ2 MFJ1 RFJ4 RFJ3 RFJ2 RFJ1 LFJ5 LFJ4 LFJ3 LFJ2 LFJ1"
THUMB = "THJ5 THJ4 THJ3 THJ2 THJ1"
MJCF_HANDS = {
    "palm_link": ((0, 0, 0, HALF, 0, HALF, 0), [f"joint_{number:02}" for number in range(16)]),
    "shadow_base": ((0, -0.01, -0.107, 0, 0, 0, 1), [*SHADOW.split(), *THUMB.split()]),
}
"""MJCF of Allegro and Shadow in DexGraspBench's `assets/hand`, by our root links.

Each has the pose (7,) of the MJCF's root in that link's frame, x y z [m] and quaternion xyzw, and its joints
in order. Other hands keep their root link and order.
"""
ASSETS, DATA, ABOUT = "assets", "graspdata", "qdgrasp.json"
FOLDERS = {ASSETS, DATA, ABOUT}
WXYZ = [0, 1, 2, 6, 3, 4, 5]  # Places in a pose, xyz and xyzw, of one with the quaternion as w, x, y, z
PRESS = 0.4  # Of a drive's greatest lead, where several fingers rest on an object, measured in MuJoCo
NEAR = 0.1  # Most that fingers are open before a grasp, from which they arrive together [rad or m]
PADS = 0.009  # Distance of the middle of a fingertip's pad from its end, as of Franka's own TCP [m]


def write_dexgraspbench(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps, and the object that they are of, as a folder for DexGraspBench."""
    postures, names = grasps.postures, list(grasps.postures.names)
    pose, joint_order = MJCF_HANDS.get(about.gripper_frame, (NO_TURN, names))
    if not set(joint_order) <= set(names):
        pose, joint_order = NO_TURN, names
    root, order = to_matrices(np.array([pose])), [names.index(name) for name in joint_order]
    joints = postures.joints
    kinds = {
        "pregrasp_qpos": joints - np.clip(joints - postures.pregrasp, -NEAR, NEAR),
        "grasp_qpos": joints,
        "squeeze_qpos": joints + (1 if grasps.scene.gripper.jaw else PRESS) * (postures.squeeze - joints),
    }
    poses = from_matrices(to_matrices(grasps.settled_poses(about.frame)) @ root)[:, WXYZ]
    qpos = {kind: np.hstack([poses, values[:, order]]) for kind, values in kinds.items()}
    folder, home = f"{ASSETS}/object/{about.object}", path / DATA / about.object
    home.mkdir(parents=True)
    place = {"obj_pose": np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), "obj_scale": 1.0, "obj_path": folder}
    for i, number in enumerate(grasps.numbers):
        grasp: Any = place | {kind: values[i] for kind, values in qpos.items()}
        np.save(home / f"{number}.npy", grasp)
    columns = {name: values.tolist() for name, values in grasps.columns(about.frame).items()}
    beside = {"joint_order": joint_order, "root": pose, "grasps": columns}
    (path / ABOUT).write_bytes(msgspec.json.encode(about.values | beside))
    _write_bench_object(path / folder, grasps.scene.object, about)


def _write_bench_object(path: Path, body: SceneObject, about: GraspMetadata) -> None:
    """Write an object's convex parts, surface and facts as the evaluator looks for them."""
    parts = [part.moved(about.object_com) for part in parse_parts(body.collision.decode())]
    facts: dict[str, Any] = {
        "gravity_center": about.object_com,
        "obb": about.object_size,
        "scale": 1.0,
        "density": 1.0,
    }
    meshes = {f"urdf/meshes/convex_piece_{i:03}.obj": part for i, part in enumerate(parts)}
    for name, mesh in (meshes | {"mesh/simplified.obj": object_mesh(body, about.frame)}).items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(parts_to_obj([mesh]))
    (path / "info").mkdir()
    facts["mass"] = sum(part.volume for part in parts)
    (path / "info/simplified.json").write_bytes(msgspec.json.encode(facts))


def write_molmospaces(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as a MolmoSpaces file."""
    hand = grasps.scene.gripper
    z = np.array([hand.approach_axis])
    y = np.array([hand.jaw.axis]) if hand.jaw else tangents(z)[1]
    tips = np.hstack([z * (hand.reach - PADS), from_frame(np.cross(y, z), y, z)])
    transforms = to_matrices(grasps.poses(about.frame)) @ to_matrices(tips)
    _write_npz(path, grasps, about, transforms=transforms)


def write_curobo(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as the arrays of a goal set for cuRobo."""
    goals = grasps.poses(about.frame)[None, None, None][..., WXYZ].astype(np.float32)
    arrays = {"position": goals[..., :3], "quaternion": goals[..., 3:]}
    _write_npz(path, grasps, about, tool_frames=np.array([about.gripper_frame]), **arrays)


BUNDLE = {"scene.xml", "replay.py", "grasps.npz", "hand", "object"}


def write_bundle(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write a folder that replays grasps in plain MuJoCo, without this project."""
    files, hand = replay_files(grasps.scene, about.object_com), grasps.scene.gripper
    files["object/mesh.obj"] = parts_to_obj([object_mesh(grasps.scene.object, about.frame)])
    for name, content in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content)
    ends = np.array([joint.closed for joint in hand.joints])  # of a jaw; others close until they press
    opened, squeeze = grasps.pregrasp, grasps.postures.squeeze[:, : len(ends)]
    closed = np.broadcast_to(ends, opened.shape) if hand.jaw else squeeze
    poses, begins = grasps.poses(about.frame), grasps.approach_poses(about.frame)
    arrays: dict[str, Any] = {
        "pose": poses,
        "way": (poses - begins)[:, :3],
        "opened": opened,
        "closed": closed,
    }
    _write_npz(path / "grasps.npz", grasps, about, **arrays, speeds=np.array(closing_speeds(grasps.scene)))


def _write_npz(path: Path, grasps: Grasps, about: GraspMetadata, **arrays: NDArray[Any]) -> None:
    """Write arrays with all columns of grasps, and their metadata as JSON in `qdgrasp`."""
    arrays |= grasps.columns(about.frame)
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, qdgrasp=np.array(about.json), **arrays)
