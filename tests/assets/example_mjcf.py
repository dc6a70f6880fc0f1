"""Example hands as MJCF files, in the style of MuJoCo Menagerie.

The jaw has two fingers that slide, which one tendon pulls and an equality couples. The linkage has two
parallelograms, closed by connects, whose cranks one tendon pulls. The finger has two joints that one tendon
bends, as the Shadow Hand's. The crooked hand has every element that moves or shapes a body.
"""

from pathlib import Path

import trimesh

JAW = """<mujoco model="jaw">
<compiler angle="radian" autolimits="true" meshdir="meshes"/>
<default>
  <default class="jaw">
    <joint type="slide" axis="0 1 0" damping="10"/>
    <default class="visual"><geom type="mesh" group="2" contype="0" conaffinity="0" density="0"/></default>
    <default class="collision"><geom type="box" group="3"/></default>
  </default>
</default>
<asset>
  <texture name="steel" type="2d" file="not_there.png"/>
  <material name="steel" texture="steel"/>
  <mesh name="look" file="not_there.stl"/>
</asset>
<worldbody>
  <light pos="0 0 1"/>
  <geom type="plane" size="1 1 1"/>
  <body name="palm" childclass="jaw" pos="0 0 0.2">
    <inertial pos="0 0 0.02" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/>
    <geom class="visual" mesh="look" material="steel"/>
    <geom class="collision" pos="0 0 0.02" size="0.03 0.07 0.02"/>
    <body name="left" pos="0 0.045 0.041">
      <joint name="slide" range="-0.04 0"/>
      <geom class="collision" pos="0 0 0.03" size="0.01 0.005 0.03" mass="0.1"/>
    </body>
    <body name="right" pos="0 -0.045 0.041" quat="0 0 0 1">
      <joint name="other" range="-0.04 0"/>
      <geom class="collision" pos="0 0 0.03" size="0.01 0.005 0.03" mass="0.1"/>
    </body>
  </body>
  <body name="thing" pos="0 0 0.5"><freejoint/><geom size="0.02"/></body>
</worldbody>
<tendon><fixed name="split">
  <joint joint="slide" coef="0.5"/><joint joint="other" coef="0.5"/>
</fixed></tendon>
<equality><joint joint1="other" joint2="slide" polycoef="0 1 0 0 0"/></equality>
<actuator>
  <position name="close" tendon="split" kp="1000" ctrlrange="-0.04 0" forcerange="-120 120"/>
</actuator>
<sensor><jointpos joint="slide"/></sensor>
<keyframe><key qpos="0 0 0 0 0.5 1 0 0 0"/></keyframe>
</mujoco>
"""

SIDE = """
<body name="{side}_crank" pos="0 0.03 0.04" euler="0 0 {turn}" childclass="bar">
  <joint name="{side}_crank" range="0 0.8"/><geom fromto="0 0 0 0 0.02 0.04"/>
</body>
<body name="{side}_rocker" pos="0 0.013 0.05" euler="0 0 {turn}" childclass="bar">
  <joint name="{side}_rocker" range="-0.3 0.9"/><geom fromto="0 0 0 0 0.02 0.04"/>
  <body name="{side}_pad" pos="0 0.02 0.04">
    <joint name="{side}_pad" range="-0.9 0.9"/>
    <geom type="box" pos="0 -0.005 0.03" size="0.01 0.004 0.02"/>
  </body>
</body>
"""
LEFT = SIDE.format(side="left", turn="0")
RIGHT = SIDE.format(side="right", turn="3.14159265").replace('pos="0 0.0', 'pos="0 -0.0', 2)
LINKAGE_MOTOR = '<general tendon="split" biastype="affine" ctrlrange="0 255" forcerange="-5 5"/>'
LINKAGE = f"""<mujoco model="linkage">
<compiler angle="radian" autolimits="true"/>
<default><default class="bar">
  <joint axis="1 0 0"/><geom type="capsule" size="0.004"/>
</default></default>
<worldbody><body name="base"><geom type="cylinder" size="0.035 0.02" pos="0 0 0.02"/>
{LEFT}{RIGHT}
</body></worldbody>
<tendon><fixed name="split">
  <joint joint="left_crank" coef="0.5"/><joint joint="right_crank" coef="0.5"/>
</fixed></tendon>
<equality>
  <connect body1="left_crank" body2="left_pad" anchor="0 0.02 0.04"/>
  <connect body1="right_crank" body2="right_pad" anchor="0 0.02 0.04"/>
</equality>
<actuator>{LINKAGE_MOTOR}</actuator>
</mujoco>
"""

FINGER = """<mujoco model="finger">
<worldbody><body name="root">
  <geom size="0.02"/>
  <body name="near" pos="0 0 0.03"><joint name="J2" axis="1 0 0" range="0 90"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.008"/>
    <body name="far" pos="0 0 0.045"><joint name="J1" axis="1 0 0" range="0 90" {spring}/>
      <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.008"/>
    </body>
  </body>
</body></worldbody>
<tendon>{tendon}</tendon>
<equality>{equality}</equality>
<actuator>{actuator}</actuator>
</mujoco>
"""

CROOKED = """<mujoco model="crooked">
<compiler eulerseq="zyx" autolimits="true"/>
<include file="parts/defaults.xml"/>
<asset>
  <mesh name="wedge" file="wedge.stl" scale="0.001 0.002 0.001" refpos="0.01 0 0" refquat="1 1 0 0"/>
</asset>
<worldbody>
  <body name="root" pos="0.1 0.2 0.3" euler="10 20 30"><freejoint/>
    <geom type="mesh" mesh="wedge" pos="0 0.01 0" euler="0 45 0"/>
    <frame pos="0 0 0.02" euler="0 30 0">
      <body name="twice" pos="0 0 0.05" childclass="round">
        <joint name="one" axis="1 1 0" pos="0.01 0 0.02" range="-60 80" ref="20"/>
        <joint name="two" axis="0 0 1" pos="0 -0.01 0.01" range="-45 45"/>
        <joint name="along" type="slide" axis="0 1 1" range="-0.02 0.03" ref="0.01"/>
        <geom fromto="0 0 0 0.01 0.02 0.05"/>
        <body pos="0.02 0 0.03" axisangle="1 0 0 90">
          <joint name="three" axis="0 1 0" pos="0 0 -0.01"/>
          <geom type="ellipsoid" size="0.01 0.02 0.03" pos="0 0 0.01"/>
          <geom type="cylinder" size="0.01 0.02" contype="0" conaffinity="0"/>
        </body>
      </body>
    </frame>
    <body name="side" pos="-0.02 0 0" xyaxes="0 1 0 -1 0 0">
      <inertial pos="0 0.01 0" mass="0.2" fullinertia="3e-4 3e-4 2e-4 1e-5 2e-5 0"/>
      <joint name="four" axis="0 0 1" range="0 1.5"/>
      <geom size="0.01"/>
    </body>
  </body>
</worldbody>
</mujoco>
"""
DEFAULTS = """<mujocoinclude><default>
  <geom density="500"/>
  <default class="round"><geom type="capsule" size="0.006"/></default>
</default></mujocoinclude>
"""


def write_crooked(folder: Path) -> Path:
    """Write the crooked hand with the file that it includes and its mesh; return its path."""
    (folder / "parts").mkdir()
    (folder / "parts/defaults.xml").write_text(DEFAULTS)
    wedge = trimesh.Trimesh(
        [[0, 0, 0], [30, 0, 0], [0, 10, 0], [0, 0, 20]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )
    wedge.export(folder / "wedge.stl")
    return write(folder, CROOKED)


def write(folder: Path, text: str, name: str = "hand.xml") -> Path:
    """Write a hand's MJCF file, and return its path."""
    (folder / name).write_text(text)
    return folder / name
