"""Lift the grasps of a bundle in plain MuJoCo: `python replay.py [N]`.

Needs mujoco and numpy alone. The open hand comes straight to its pose, between the object's neighbours, and
closes on an object that resists as on a table, with friction of half its weight. Then gravity begins, and the
hand rises 10 cm. Servos have the force of the protocol, contacts its friction, elliptic cones and impratio 10
(scene.xml). With weaker servos, or other contacts, more objects are dropped.
"""

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

REST, SPEED, HEIGHT, LEAST = 0.3, 0.1, 0.1, 0.08  # [s], of the lift [m/s], [m], way of a lifted object [m]
PLACES = 21  # on the way to a pose
TABLE, LEVER = 0.5, 0.03  # Friction as of a table: share of the weight, lever of its torque [m]


def replay(model: Any, grasp: dict[str, Any], speeds: Any) -> tuple[bool, bool]:
    """Return whether a grasp lifts the object 8 cm, and whether it is clear before.

    `grasp` has `pose` (7,), xyz [m] and quaternion xyzw of the hand in the object's frame, `way` (3,) from
    where it begins to there [m], and `opened` and `closed` (j,), targets of the joints that the actuators
    drive; `speeds` (j,) are theirs [m/s, rad/s]. A finger has to touch the object at the end; the grasp is
    clear if the hand touches no neighbour until the lift.
    """
    data, mount, thing = mujoco.MjData(model), model.body("mount").id, model.body("object").id

    def touching() -> Any:  # pairs of bodies (n, 2), and which of them are of the object
        pairs = model.geom_bodyid[data.contact.geom[data.contact.dist < 0]]
        return pairs, np.any(pairs == thing, axis=1)

    def is_clear() -> bool:
        pairs, of_object = touching()
        return 0 not in pairs[~of_object]

    model.body_quat[mount], clear = grasp["pose"][[6, 3, 4, 5]], True
    data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = data.ctrl[:] = grasp["opened"]
    for ahead in np.linspace(1, 0, PLACES):
        model.body_pos[mount] = grasp["pose"][:3] - ahead * grasp["way"]
        mujoco.mj_forward(model, data)
        clear = clear and is_clear()
    start, change = data.xipos[thing, 2], speeds * model.opt.timestep
    closing = np.max(np.abs(grasp["closed"] - grasp["opened"]) / speeds) + REST
    weight = 9.81 * model.body_mass[thing]
    phases = (closing, 0, 0), (REST, 1, 0), (HEIGHT / SPEED, 1, SPEED), (REST, 1, 0)
    for seconds, gravity, velocity in phases:
        model.opt.gravity[:] = 0, 0, -9.81 * gravity
        model.dof_frictionloss[-6:] = TABLE * weight * (1 - gravity) * np.repeat([1, LEVER], 3)
        for _ in range(round(seconds / model.opt.timestep)):
            data.ctrl += np.clip(grasp["closed"] - data.ctrl, -change, change)
            data.qvel[0] = velocity  # of the hand
            mujoco.mj_step(model, data)
            clear = clear and (gravity > 0 or is_clear())
    pairs, of_object = touching()
    holding = set(pairs[of_object].flat) - {0, thing}
    has_finger = any(model.body_weldid[body] != model.body_weldid[mount] for body in holding)
    return bool(has_finger and data.xipos[thing, 2] - start > LEAST), clear


if __name__ == "__main__":
    home, most = Path(__file__).parent, int(sys.argv[1]) if len(sys.argv) > 1 else 10
    model = mujoco.MjModel.from_xml_path(str(home / "scene.xml"))
    grasps = dict(np.load(home / "grasps.npz", allow_pickle=False))
    columns = {key: grasps[key][:most] for key in ("pose", "way", "opened", "closed")}
    lines = [dict(zip(columns, line, strict=True)) for line in zip(*columns.values(), strict=True)]
    found = [replay(model, line, grasps["speeds"]) for line in lines]
    lifted, clear = np.array(found, bool).reshape(-1, 2).T
    dropped = " ".join(map(str, grasps["number"][:most][~lifted])) or "none"
    sys.stdout.write(f"{sum(lifted)} of {len(lines)} lifted; dropped: {dropped}\n")
    if 0 in model.geom_bodyid:
        sys.stdout.write(f"{sum(clear)} of {len(lines)} touch no neighbour before\n")
