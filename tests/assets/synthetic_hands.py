"""URDFs of hands made of boxes, each of which was once guessed wrong, or would be easily.

All have a palm that lies in the plane y = 0, with its fingers along z, and grasp along +y.
"""

from tests.assets.example_hands import INERTIA

SIDE, LENGTH = 0.014, 0.04
"""Thickness and length of a finger's links [m]."""


def link(name: str, size: str = f"{SIDE} {SIDE} {LENGTH}", place: str = f"0 0 {LENGTH / 2}") -> str:
    """A link that is a box of a size, around a place."""
    return (
        f'<link name="{name}"><inertial><mass value="0.1"/>{INERTIA}</inertial>'
        f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision></link>'
    )


def hinge(
    name: str, ends: tuple[str, str], place: str, axis: str, limits: tuple[float, float], mimics: str = ""
) -> str:
    """A revolute joint between two links; `mimics` are the attributes of its <mimic>."""
    parent, child = ends
    mimic = f"<mimic {mimics}/>" if mimics else ""
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="5" velocity="8"/>{mimic}</joint>'
    )


def robot(*parts: str) -> str:
    """A URDF of links and joints."""
    return "\n".join(['<robot name="hand">', *parts, "</robot>"])


def curling_finger(name: str, parent: str, place: str) -> str:
    """A finger along z that spreads by +-60 degrees about y, and curls toward y by three parallel joints.

    The first of these comes before the joint that spreads, as in the LEAP hand, and each may bend back too.
    """
    limits, above = (-0.3, 1.6), f"0 0 {LENGTH + 0.002}"
    return "".join(
        [
            hinge(f"{name}_bend", (parent, f"{name}_root"), place, "-1 0 0", limits),
            link(f"{name}_root", f"{SIDE} {SIDE} 0.01", "0 0 0.005"),
            hinge(f"{name}_spread", (f"{name}_root", f"{name}_low"), "0 0 0.012", "0 1 0", (-1.05, 1.05)),
            link(f"{name}_low"),
            hinge(f"{name}_curl", (f"{name}_low", f"{name}_mid"), above, "-1 0 0", limits),
            link(f"{name}_mid"),
            hinge(f"{name}_tip", (f"{name}_mid", f"{name}_end"), above, "-1 0 0", limits),
            link(f"{name}_end"),
        ]
    )


def folding_thumb(parent: str) -> str:
    """A thumb that lies across the front of the palm at zero, and bends either way as far.

    Turned about z by 90 degrees it stands out of the palm, and its upward bend meets the fingers.
    """
    size, place = f"{LENGTH} {SIDE} {SIDE}", f"{LENGTH / 2} 0 0"
    return "".join(
        [
            hinge("thumb_turn", (parent, "thumb_root"), "0 0.016 0.006", "0 0 1", (-0.3, 2.1)),
            link("thumb_root", f"{SIDE} {SIDE} {SIDE}", "0 0 0"),
            hinge("thumb_curl", ("thumb_root", "thumb_low"), "0.01 0 0", "0 -1 0", (-1.3, 1.5)),
            link("thumb_low", size, place),
            hinge("thumb_tip", ("thumb_low", "thumb_end"), f"{LENGTH + 0.002} 0 0", "0 -1 0", (-1.3, 1.5)),
            link("thumb_end", size, place),
        ]
    )


PALM = link("palm", "0.1 0.024 0.08", "0 0 0.04")
PLACES = ("-0.034 0 0.084", "0 0 0.084", "0.034 0 0.084")
"""Where fingers begin on the palm [m]."""
NAMES = ("one", "two", "three")
THUMB_HAND = robot(
    PALM,
    *(curling_finger(name, "palm", place) for name, place in zip(NAMES, PLACES, strict=True)),
    folding_thumb("palm"),
)
"""Three fingers and a thumb."""
HALVED_HAND = robot(
    link("palm", "0.04 0.024 0.08", "0.03 0 0.04"),
    hinge("fold", ("palm", "half"), "0.01 0 0", "0 0 -1", (0.0, 0.3), 'joint="thumb_turn" multiplier="0.1"'),
    link("half", "0.056 0.024 0.08", "-0.03 0 0.04"),
    curling_finger("one", "half", "-0.044 0 0.084"),
    curling_finger("two", "half", "-0.01 0 0.084"),
    curling_finger("three", "palm", PLACES[2]),
    folding_thumb("palm"),
)
"""The same, but that the palm folds in half where the thumb turns."""


def claw(*, mimics: bool = False) -> str:
    """Two fingers, 8 cm apart and 9 cm long, which would meet after a third of their way to each other."""
    limits, size, place = (0.0, 1.4), "0.02 0.01 0.09", "0 0 0.045"
    return robot(
        link("palm", "0.06 0.1 0.04", "0 0 0.02"),
        hinge("left", ("palm", "left_finger"), "0 0.04 0.042", "1 0 0", limits),
        link("left_finger", size, place),
        hinge(
            "right",
            ("palm", "right_finger"),
            "0 -0.04 0.042",
            "-1 0 0",
            limits,
            'joint="left"' if mimics else "",
        ),
        link("right_finger", size, place),
    )
