"""Grasps of a bundle beside the boxes of a scene's file: what the hand touches before it lifts.

`python -m benchmarks.scene_replay BUNDLE SCENE.toml` says of how many grasps the hand touches no box.
"""

import sys
import tomllib
from pathlib import Path

import mujoco
import numpy as np

WAY, STEP, REST = 0.1, 0.005, 0.3  # [m], [m], [s]


def clear_grasps(bundle: Path, scene: Path) -> list[bool]:
    """Whether the hand touches no box on its way, nor while it closes, in plain MuJoCo; for each grasp."""
    spec = mujoco.MjSpec.from_file(str(bundle / "scene.xml"))
    for number, body in enumerate(tomllib.loads(scene.read_text())["body"]):
        half = np.array(body["box"]) / 2
        groups = {"contype": 3, "conaffinity": 3}
        kind = mujoco.mjtGeom.mjGEOM_BOX
        spec.worldbody.add_geom(name=f"box_{number}", type=kind, size=half, pos=body["position"], **groups)
    model, grasps = spec.compile(), np.load(bundle / "grasps.npz")
    model.opt.gravity[:] = 0
    columns = (grasps[name] for name in ("pose", "opened", "closed"))
    return [is_clear(model, *grasp, grasps["speeds"]) for grasp in zip(*columns, strict=True)]


def is_clear(model, pose, opened, closed, speeds) -> bool:
    """Move the open hand to its pose (7,) along its z, and close it; whether it touches no box."""
    data, mount, thing = mujoco.MjData(model), model.body("mount").id, model.body("object").id
    boxes = [i for i in range(model.ngeom) if model.geom(i).name.startswith("box_")]

    def touches() -> bool:
        geoms = data.contact.geom[data.contact.dist < 0]
        with_box = geoms[np.isin(geoms, boxes).any(axis=1)]
        return bool((model.geom_bodyid[with_box] != thing).all(axis=1).any())

    model.body_quat[mount] = pose[[6, 3, 4, 5]]
    data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = data.ctrl[:] = opened
    mujoco.mj_forward(model, data)
    along = data.xmat[mount].reshape(3, 3)[:, 2]
    for back in np.arange(WAY, -STEP / 2, -STEP):
        model.body_pos[mount] = pose[:3] - back * along
        mujoco.mj_forward(model, data)
        if touches():
            return False
    way = speeds * model.opt.timestep
    model.dof_damping[-6:] = 100 * model.body_mass[thing]  # the object rests on something
    for _ in range(round((np.max(np.abs(closed - opened) / speeds) + REST) / model.opt.timestep)):
        data.ctrl += np.clip(closed - data.ctrl, -way, way)
        mujoco.mj_step(model, data)
        if touches():
            return False
    return True


if __name__ == "__main__":
    found = clear_grasps(Path(sys.argv[1]), Path(sys.argv[2]))
    sys.stdout.write(f"{sum(found)} of {len(found)} grasps touch nothing before the lift\n")
