"""The grasps of a run as arrays: `python grasps.py runs/mug`."""

import sys

import numpy as np

import qdgrasp

run = qdgrasp.open(sys.argv[1])
print(run.summary.words)

# All at once, under `physical` those that hold: poses of the hand's root link in the frame of the object's
# mesh file, in metres. Settled poses go with the joints after closing, found.poses and found.pregrasp with
# each other: the hand before it closes.
found = run.grasps()
poses = found.settled_poses("mesh")  # (n, 7): x y z, qx qy qz qw
print(f"{len(found)} grasps, positions within {np.ptp(poses[:, :3], axis=0).round(3)} m")

# One after the other: five that are well spread, the best one first.
for grasp in run.grasps(diverse=5):
    joints = ", ".join(
        f"{name} {value:.3f}" for name, value in zip(found.joint_names, grasp.joints, strict=True)
    )
    print(f"{grasp.number}: {grasp.outcome.name} at {grasp.settled_position.round(3)} m with {joints}")

# Everything else is there as well: every evaluation with its genome and its outcome, failures too.
rows = run.rows()
for outcome in qdgrasp.Outcome:
    print(f"{outcome.name}: {np.count_nonzero(rows['outcome'] == outcome)} of {len(rows)} evaluations")

np.savez(f"{run.path.absolute()}-grasps.npz", poses=poses, joints=found.joints)
