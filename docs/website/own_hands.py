"""URDFs of three grippers of which no package has a file, drawn from what their makers publish.

Each has the linkage of the real one: strokes are those of the data sheet, and the outer sizes are near it.
Shapes are boxes, and masses of links are estimated.
"""

from math import sin
from typing import NamedTuple

Point = tuple[float, float, float]


class Parallelogram(NamedTuple):
    """A gripper whose fingers are carried by two cranks each, so that they stay parallel."""

    palm: Point
    """Size of its box [m], which stands on z = 0."""
    root: float
    """Height of the outer cranks' axes [m]."""
    crank: float
    """Length of the cranks [m]."""
    low: float
    """Angle of the cranks from z, closed [rad]; negative: inward."""
    high: float
    """Angle of the cranks from z, open [rad]."""
    finger: Point
    """Size of a finger's box [m]."""
    torque: float
    """Of a crank [Nm]: the rated force times the crank."""
    speed: float
    """Of a crank [rad/s]."""

    @property
    def axis(self) -> float:
        """Distance [m] of the outer cranks' axes from the middle, with which the closed fingers meet."""
        return self.finger[1] - self.crank * sin(self.low)


PIN = 0.004  # How far a finger reaches below the pins that hold it to its cranks [m]
RG2 = Parallelogram((0.036, 0.075, 0.11), 0.11, 0.055, -0.5236, 0.5236, (0.024, 0.014, 0.048), 2.2, 2.9)
AG95 = Parallelogram((0.055, 0.08, 0.1), 0.1, 0.0575, -0.425, 0.425, (0.026, 0.012, 0.055), 9.2, 1.2)


def parallelogram_urdf(name: str, made: Parallelogram) -> str:
    """Return the URDF of a gripper whose two fingers hang on cranks: one joint leads, five follow."""
    wide, thick, tall = made.finger
    said = [link("palm", made.palm, (0, 0, made.palm[2] / 2), mass=0.5)]
    for side, way in (("left", 1), ("right", -1)):
        lead = "" if side == "left" else mimic("left_crank_joint", 1)
        for kind, beside in (("crank", made.axis), ("inner_crank", made.axis - 0.011)):
            follows = lead if kind == "crank" else mimic("left_crank_joint", 1)
            said += [
                link(
                    f"{side}_{kind}", (wide * 0.6, 0.006, made.crank), (0, 0, made.crank / 2), mass=0.04
                ),
                joint(
                    f"{side}_{kind}_joint", ("palm", f"{side}_{kind}"), (0, way * beside, made.root),
                    (-way, 0, 0), (made.low, made.high), made.torque, made.speed, follows,
                ),
            ]  # fmt: skip
        said += [
            link(f"{side}_finger", made.finger, (0, -way * thick / 2, tall / 2 - PIN), mass=0.05),
            joint(
                f"{side}_finger_joint", (f"{side}_crank", f"{side}_finger"), (0, 0, made.crank),
                (-way, 0, 0), (-made.high, -made.low), made.torque, made.speed, mimic("left_crank_joint", -1),
            ),
        ]  # fmt: skip
    return robot(name, said)


def wsg50_urdf() -> str:
    """Return the URDF of a WSG 50: two jaws of 55 mm stroke that one drive moves."""
    said = [link("palm", (0.05, 0.146, 0.072), (0, 0, 0.036), mass=1.0)]
    for side, way in (("left", 1), ("right", -1)):
        follows = "" if side == "left" else mimic("left_jaw_joint", 1)
        said += [
            link(f"{side}_jaw", (0.024, 0.012, 0.08), (0, way * 0.006, 0.04), mass=0.1),
            joint(
                f"{side}_jaw_joint", ("palm", f"{side}_jaw"), (0, 0, 0.074), (0, way, 0),
                (0.0, 0.055), 80, 0.42, follows, kind="prismatic",
            ),
        ]  # fmt: skip
    return robot("wsg50", said)


def link(name: str, size: Point, middle: Point, *, mass: float) -> str:
    """A link that is one box, as thick as it weighs."""
    x, y, z = size
    inertia = [mass * (a * a + b * b) / 12 for a, b in ((y, z), (x, z), (x, y))]
    origin, box = f'<origin xyz="{words(middle)}"/>', f'<geometry><box size="{words(size)}"/></geometry>'
    moments = " ".join(
        f'{key}="{value:.3g}"' for key, value in zip(("ixx", "iyy", "izz"), inertia, strict=True)
    )
    return (
        f'<link name="{name}"><inertial>{origin}<mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<visual>{origin}{box}</visual><collision>{origin}{box}</collision></link>"
    )


def joint(
    name: str, links: tuple[str, str], origin: Point, axis: Point, limits: tuple[float, float],
    effort: float, velocity: float, follows: str, *, kind: str = "revolute",
) -> str:  # fmt: skip
    """A joint between two links, which may follow another one."""
    low, high = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{links[0]}"/><child link="{links[1]}"/>'
        f'<origin xyz="{words(origin)}"/><axis xyz="{words(axis)}"/>'
        f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>{follows}</joint>'
    )


def mimic(leader: str, factor: int) -> str:
    """What makes a joint follow another."""
    return f'<mimic joint="{leader}" multiplier="{factor}"/>'


def robot(name: str, parts: list[str]) -> str:
    """A whole URDF."""
    return "\n".join([f'<robot name="{name}">', *parts, "</robot>\n"])


def words(point: Point) -> str:
    """Numbers as XML has them."""
    return " ".join(f"{value:.6g}" for value in point)
