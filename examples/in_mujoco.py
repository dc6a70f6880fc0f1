"""The best grasp of a CSV file in MuJoCo: `python in_mujoco.py my_hand.urdf part.stl part.csv`."""

import csv
import sys
from pathlib import Path

import mujoco
import numpy as np

hand_file, object_file, grasps = sys.argv[1:]
lines = Path(grasps).read_text().splitlines()
facts = dict(line.removeprefix("# ").split(": ", 1) for line in lines if ": " in line)
best = next(csv.DictReader(line for line in lines if not line.startswith("#")))
joints = [name.removeprefix("joint.") for name in best if name.startswith("joint.")]
# The hand stands at the origin. The object is free, at the inverse of the commanded pose of the hand.
spec = mujoco.MjSpec.from_file(hand_file)
if (root := ", ".join(body.name for body in spec.worldbody.bodies)) != (frame := facts["gripper_frame"]):
    sys.exit(f"Poses are of {frame}, the root of {hand_file} is {root}: give a URDF whose root is {frame}.")
spec.body(frame).pos, spec.body(frame).quat = (0, 0, 0), (1, 0, 0, 0)  # wherever it is in a link `world`
spec.option.gravity, spec.option.integrator = (0, 0, 0), mujoco.mjtIntegrator.mjINT_IMPLICITFAST
spec.add_mesh(name="object", file=str(Path(object_file).absolute()), scale=[float(facts["object_scale"])] * 3)
body = spec.worldbody.add_body(name="object")
body.add_freejoint()
body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="object", mass=float(facts["object_mass"]), condim=6)
for name in joints:
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    is_slide = spec.joint(name).type == mujoco.mjtJoint.mjJNT_SLIDE
    servo.set_to_position(**({"kp": 500, "kv": 20} if is_slide else {"kp": 20, "kv": 2}))
    spec.joint(name).armature = 0.01  # the rotor's inertia, without which light fingers shake
data = mujoco.MjData(model := spec.compile())
back = np.array([float(best[name]) for name in ("qw", "qx", "qy", "qz")]) * (1, -1, -1, -1)
mujoco.mju_rotVecQuat(away := np.zeros(3), -np.array([float(best[name]) for name in "xyz"]), back)
data.joint(model.body("object").jntadr[0]).qpos[:] = [*away, *back]
opened, closed = (np.array([float(best[kind + name]) for name in joints]) for kind in ("pregrasp.", "joint."))
data.qpos[[model.joint(name).qposadr[0] for name in joints]] = opened
for step in range(1000):  # of 2 ms; in the end twice as far as the joint came when it closed, to press
    data.ctrl[:] = opened + min(step / 250, 2) * (closed - opened)
    mujoco.mj_step(model, data)
moved = 1000 * np.linalg.norm(data.body("object").xpos - away)
print(f"grasp {best['number']}: {data.ncon} contacts after {data.time:.1f} s, object moved {moved:.1f} mm")
