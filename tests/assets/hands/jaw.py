"""A jaw of boxes with two fingers that slide, the second mimicking the first, and its gripper's file."""

INERTIA = '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>'

URDF = f"""<robot name="jaw">
<link name="palm"><inertial><mass value="0.5"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.02"/><geometry><box size="0.06 0.14 0.04"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="palm"/><child link="left"/>
<origin xyz="0 0.045 0.041"/><axis xyz="0 1 0"/>
<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/></joint>
<link name="left"><inertial><mass value="0.1"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision></link>
<joint name="other" type="prismatic"><parent link="palm"/><child link="right"/>
<origin xyz="0 -0.045 0.041"/><axis xyz="0 -1 0"/>
<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/><mimic joint="slide"/></joint>
<link name="right"><inertial><mass value="0.1"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision></link>
</robot>"""

TOML = """urdf = "jaw.urdf"
licence = "CC0"
base_link = "palm"
approach_axis = [0, 0, 1]
palm_offset = 0.04
standoff = [0.0, 0.06]
finger_links = ["left", "right"]

[jaw]
axis = [0, 1, 0]
opening = 0.08

[joints.slide]
open = 0.0
closed = -0.04

[joints.other]
open = 0.0
closed = -0.04
"""
