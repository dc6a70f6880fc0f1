"""A two-finger hand whose fingers stay parallel: one joint leads, three mimic it, as those of Robotiq do."""

INERTIA = '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>'
LIMIT = '<limit lower="{}" upper="{}" effort="20" velocity="2"/>'


def link(name: str, mass: float, place: str, size: str) -> str:
    """A link that is a box."""
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/>{INERTIA}</inertial>'
        f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision></link>'
    )


def joint(name: str, parent: str, child: str, place: str, sense: int, mimics: int = 0) -> str:
    """A joint about x that turns by 0 to 0.7 rad, or mimics the leader."""
    limit = LIMIT.format(-0.7, 0) if sense < 0 else LIMIT.format(0, 0.7)
    mimic = f'<mimic joint="knuckle" multiplier="{mimics}"/>' if mimics else ""
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="1 0 0"/>{limit}{mimic}</joint>'
    )


URDF = "\n".join(
    [
        '<robot name="linkage">',
        link("palm", 0.6, "0 0 0.03", "0.06 0.12 0.06"),
        joint("knuckle", "palm", "left_knuckle", "0 0.055 0.06", 1),
        link("left_knuckle", 0.05, "0 0 0.025", "0.02 0.008 0.05"),
        joint("left_pad", "left_knuckle", "left_finger", "0 0 0.05", -1, -1),
        link("left_finger", 0.05, "0 -0.008 0.03", "0.022 0.012 0.06"),
        joint("other", "palm", "right_knuckle", "0 -0.055 0.06", -1, -1),
        link("right_knuckle", 0.05, "0 0 0.025", "0.02 0.008 0.05"),
        joint("right_pad", "right_knuckle", "right_finger", "0 0 0.05", 1, 1),
        link("right_finger", 0.05, "0 0.008 0.03", "0.022 0.012 0.06"),
        "</robot>",
    ]
)
