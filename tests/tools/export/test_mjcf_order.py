"""Files in the order of an MJCF place its bodies where the links of our hand are."""

import mujoco
import numpy as np
from msgspec.structs import replace
from tests.coordinator.recorded_runs import record
from tests.tools.export.conftest import SLOTS, random_rows

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.export.exporter import export_grasps

FINGER = """
<body name="{0}b" pos="{1}" quat="{2}"><joint name="{0}0" axis="0 0 1"/>
 <body pos="0 0 0.0164"><joint name="{0}1"/>
  <body pos="0 0 0.054"><joint name="{0}2"/>
   <body name="{0}" pos="0 0 0.0384"><joint name="{0}3"/></body></body></body></body>
"""
THUMB = """
<body pos="-0.0182 0.019333 -0.045987" quat="0.477714 -0.521334 -0.521334 -0.477714"><joint axis="-1 0 0"/>
 <body pos="-0.027 0.005 0.0399"><joint axis="0 0 1"/>
  <body pos="0 0 0.0177"><joint/>
   <body name="th" pos="0 0 0.0514"><joint/></body></body></body></body>
"""
PLACES = {
    "ff": ("0 0.0435 -0.001542", "0.999048 -0.0436194 0 0"),
    "mf": ("0 0 0.0007", "1 0 0 0"),
    "rf": ("0 -0.0435 -0.001542", "0.999048 0.0436194 0 0"),
}
ALLEGRO = f"""
<mujoco><compiler angle="radian" inertiafromgeom="true"/>
<default>
<joint axis="0 1 0"/><geom type="sphere" size="0.01"/></default>
<worldbody><body name="root"><freejoint/><body name="palm" quat="0 1 0 1">
{"".join(FINGER.format(name, *place) for name, place in PLACES.items())}{THUMB}
</body></body></worldbody></mujoco>
""".replace("><joint", "><geom/><joint").replace("<freejoint/>", "<geom/><freejoint/>")
"""Frames and joints of the Allegro hand as MuJoCo Menagerie and DexGraspBench have them."""


def test_allegro_in_dexgraspbench_has_its_fingertips_where_ours_are(tmp_path) -> None:
    scene = replace(build_scene(RunSpec(gripper="allegro", object="rubiks_cube")), contact_slots=SLOTS)
    rows = random_rows(scene, [Outcome.HELD] * 3)
    run = record(tmp_path / "run", scene, rows, gripper="allegro", method="contact_rand")
    export_grasps(run, tmp_path / "out", "dexgraspbench", frame="com")
    model = mujoco.MjModel.from_xml_string(ALLEGRO)
    data, geometry = mujoco.MjData(model), hand_geometry(scene.gripper)
    tips = {"ff": "link_03", "mf": "link_07", "rf": "link_11", "th": "link_15"}
    for number, row in enumerate(rows):
        (path,) = (tmp_path / "out").glob(f"graspdata/*/{number}.npy")
        data.qpos[:] = np.load(path, allow_pickle=True).item()["grasp_qpos"]
        mujoco.mj_kinematics(model, data)
        frames = geometry.link_frames(row["settled"].astype(float), row["joints"].astype(float))
        for body, link in tips.items():
            frame = np.column_stack([data.body(body).xmat.reshape(3, 3), data.body(body).xpos])
            np.testing.assert_allclose(frame, frames[link][:3], atol=1e-5)
