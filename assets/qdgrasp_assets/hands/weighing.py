"""Masses for links that have none: those of solids of water, which hollow ones of metal are near."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator

import numpy as np

from qdgrasp_assets.hands.overlap import Floats
from qdgrasp_assets.hands.structure import listed
from qdgrasp_assets.hands.weight import unweighed
from qdgrasp_assets.urdf import Urdf

DENSITY = 1000.0
"""Of what has shapes [kg/m3]."""
FRAME_MASS = 1e-3
"""Of what has none: frames, tips, mounts [kg]."""
LEAST_SIDE = 5e-3
"""Inertia is that of a box with sides of this length at least [m]."""

Corners = Callable[[Urdf, str], tuple[Floats, ...]]
"""The corners of the convex parts of a link, link frame."""


def weigh(hand: Urdf, corners: Corners) -> Iterator[str]:
    """Give a mass and an inertia to each link of a hand that lacks them, in its element; and say so."""
    given: list[str] = []
    wrong = unweighed(hand.element)
    for link in hand.element.findall("link"):
        name = link.get("name", "")
        if name not in wrong:
            continue
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = _inertial(corners(hand, name))
        link.append(inertial)
        (mass,) = inertial.iter("mass")
        given.append(f"{name} {float(mass.get('value', 0)):.3g}")
    if given:
        yield (
            f"{listed('link', [words.partition(' ')[0] for words in given])} given a mass, by the size of "
            f"the shapes at {DENSITY:g} kg/m3 ({', '.join(given)} kg)"
        )


def _inertial(parts: tuple[Floats, ...]) -> ET.Element:
    """Mass and inertia of convex parts, as of a box around them."""
    volume = sum(_volume(part) for part in parts)
    mass = max(DENSITY * volume, FRAME_MASS)
    corners = np.concatenate([np.zeros((0, 3)), *parts])
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (np.zeros(3), np.zeros(3))
    sides = np.maximum(high - low, LEAST_SIDE) ** 2
    moments = mass / 12 * (sides.sum() - sides)
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(f"{value:.6g}" for value in (low + high) / 2), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.6g}")
    names = {name: f"{moment:.6g}" for name, moment in zip(("ixx", "iyy", "izz"), moments, strict=True)}
    ET.SubElement(inertial, "inertia", {**names, "ixy": "0", "ixz": "0", "iyz": "0"})
    return inertial


def _volume(corners: Floats) -> float:
    """Of the hull of corners (v, 3) [m3]; none of what is flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(corners).volume)
    except (QhullError, ValueError):
        return 0.0
