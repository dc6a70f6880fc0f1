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

# The hand stays where its file has it. The object is free, at the inverse of the commanded pose of the hand.
spec = mujoco.MjSpec.from_file(hand_file)
spec.option.gravity, spec.option.integrator = (0, 0, 0), mujoco.mjtIntegrator.mjINT_IMPLICITFAST
spec.add_mesh(name="object", file=str(Path(object_file).absolute()), scale=[float(facts["object_scale"])] * 3)
body = spec.worldbody.add_body(name="object")
body.add_freejoint()
body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="object", mass=float(facts["object_mass"]), condim=6)
for name in joints:
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=500, kv=20)
model = spec.compile()
data = mujoco.MjData(model)

back, away = np.zeros(4), np.zeros(3)
mujoco.mju_negQuat(back, np.array([float(best[name]) for name in ("qw", "qx", "qy", "qz")]))
mujoco.mju_rotVecQuat(away, -np.array([float(best[name]) for name in "xyz"]), back)
data.joint(model.body("object").jntadr[0]).qpos[:] = [*away, *back]
for name in joints:  # open, and then twice as far as the joint came when it closed, to press
    opened, closed = float(best[f"pregrasp.{name}"]), float(best[f"joint.{name}"])
    data.joint(name).qpos[:], data.actuator(name).ctrl[:] = opened, 2 * closed - opened
mujoco.mj_step(model, data, 1000)
moved = 1000 * np.linalg.norm(data.body("object").xpos - away)
print(
    f"grasp {best['number']}: {data.ncon} contacts after {data.time:.1f} s, the object moved {moved:.1f} mm"
)
