"""Lift the grasps of a bundle in plain MuJoCo: `python replay.py [N]`.

Needs mujoco and numpy alone. The open hand is put to its pose and closes on an object that resists as on a
table, with friction of half its weight. Then gravity begins, and the hand rises 10 cm. Servos have the force
of the protocol, contacts its friction, elliptic cones and impratio 10 (scene.xml). With weaker servos, or
other contacts, more objects are dropped.
"""

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

REST, SPEED, HEIGHT, LEAST = 0.3, 0.1, 0.1, 0.08  # [s], of the lift [m/s], [m], way of a lifted object [m]
TABLE, LEVER = 0.5, 0.03  # Friction as of a table: share of the weight, lever of its torque [m]


def lifts(model: Any, grasp: dict[str, Any], speeds: Any) -> bool:
    """Return whether a grasp lifts the object 8 cm, and a finger touches it then.

    `grasp` has `pose` (7,), xyz [m] and quaternion xyzw of the hand in the object's frame, and `opened` and
    `closed` (j,), targets of the joints that the actuators drive; `speeds` (j,) are theirs [m/s, rad/s].
    """
    data, mount, thing = mujoco.MjData(model), model.body("mount").id, model.body("object").id
    model.body_pos[mount], model.body_quat[mount] = grasp["pose"][:3], grasp["pose"][[6, 3, 4, 5]]
    data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = data.ctrl[:] = grasp["opened"]
    mujoco.mj_forward(model, data)
    start, way = data.xipos[thing, 2], speeds * model.opt.timestep
    closing = np.max(np.abs(grasp["closed"] - grasp["opened"]) / speeds) + REST
    weight = 9.81 * model.body_mass[thing]
    phases = (closing, 0, 0), (REST, 1, 0), (HEIGHT / SPEED, 1, SPEED), (REST, 1, 0)
    for seconds, gravity, velocity in phases:
        model.opt.gravity[:] = 0, 0, -9.81 * gravity
        model.dof_frictionloss[-6:] = TABLE * weight * (1 - gravity) * np.repeat([1, LEVER], 3)
        for _ in range(round(seconds / model.opt.timestep)):
            data.ctrl += np.clip(grasp["closed"] - data.ctrl, -way, way)
            data.qvel[0] = velocity  # of the hand
            mujoco.mj_step(model, data)
    touching = set(model.geom_bodyid[data.contact.geom[data.contact.dist < 0]].flat) - {thing}
    has_finger = any(model.body_weldid[body] != model.body_weldid[mount] for body in touching)
    return bool(has_finger and data.xipos[thing, 2] - start > LEAST)


if __name__ == "__main__":
    home, most = Path(__file__).parent, int(sys.argv[1]) if len(sys.argv) > 1 else 10
    model = mujoco.MjModel.from_xml_path(str(home / "scene.xml"))
    grasps = dict(np.load(home / "grasps.npz", allow_pickle=False))
    numbers, arrays = grasps["number"][:most], {key: grasps[key] for key in ("pose", "opened", "closed")}
    lifted = [
        lifts(model, {key: each[n] for key, each in arrays.items()}, grasps["speeds"])
        for n in range(len(numbers))
    ]
    dropped = " ".join(str(number) for number, up in zip(numbers, lifted, strict=True) if not up)
    sys.stdout.write(f"{sum(lifted)} of {len(numbers)} lifted; dropped: {dropped or 'none'}\n")
