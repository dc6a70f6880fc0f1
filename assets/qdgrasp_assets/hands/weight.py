"""The masses of a hand: what the simulator would refuse, hold still or make up, in words."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

from qdgrasp_assets.hands.structure import edges, listed

HEAVIEST = 30.0
"""A hand weighs less [kg]; what weighs more is given in grams."""


def weight_faults(element: ET.Element) -> tuple[str, ...]:
    """What is wrong with the masses of a `<robot>`'s links; empty when nothing is."""
    links = {link.get("name", ""): link.find("inertial") for link in element.findall("link")}
    masses = {name: _mass(inertial) for name, inertial in links.items() if inertial is not None}
    return tuple(
        f"{listed('link', names)} {told}" for names, told in _kinds(element, links, masses) if names
    ) + tuple(_heavy(masses))


def _kinds(
    element: ET.Element, links: dict[str, ET.Element | None], masses: dict[str, float | None]
) -> Iterator[tuple[list[str], str]]:
    """Links by what is wrong with them."""
    held = _carried_by_fixed_joints(element)
    yield (
        [name for name, inertial in links.items() if inertial is None],
        "without <inertial>, for which the simulator would take 1 kg: give a mass and an inertia, or have "
        "`qdgrasp gripper new --mend` do it",
    )
    yield (
        [name for name, inertial in links.items() if inertial is not None and _is_incomplete(inertial)],
        "with an <inertial> that lacks <mass> or <inertia>, which the simulator refuses: give both",
    )
    yield (
        [name for name, mass in masses.items() if mass is not None and mass < 0],
        "of a negative mass: give it in kg",
    )
    yield (
        [name for name, mass in masses.items() if mass == 0 and name not in held],
        "of mass 0, which the simulator holds still in the air: give it its mass in kg",
    )


def _is_incomplete(inertial: ET.Element) -> bool:
    return inertial.find("mass") is None or inertial.find("inertia") is None


def _carried_by_fixed_joints(element: ET.Element) -> set[str]:
    """Links that move with their parent, where no mass of their own is needed."""
    fixed = [joint.get("type") == "fixed" for joint in element.findall("joint")]
    return {child for (_, child), is_fixed in zip(edges(element), fixed, strict=True) if is_fixed}


def _mass(inertial: ET.Element) -> float | None:
    """The mass [kg]; None where there is no number."""
    mass = inertial.find("mass")
    try:
        return None if mass is None else float(mass.get("value", ""))
    except ValueError:
        return None


def _heavy(masses: dict[str, float | None]) -> Iterator[str]:
    total = sum(mass or 0.0 for mass in masses.values())
    if total > HEAVIEST:
        yield f"it weighs {total:.4g} kg, which looks like grams: masses are in kg, so multiply them by 0.001"
