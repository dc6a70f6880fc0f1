"""The masses of a hand: what the simulator would refuse, hold still or make up, in words."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping

from qdgrasp_assets.hands.structure import edges, listed

HEAVIEST = 30.0
"""A hand weighs less [kg]; what weighs more is given in grams."""
MEND = "or have `qdgrasp gripper new --mend` do it"

Masses = Mapping[str, float | None]
"""Of links by their names [kg]; None where the file says no number."""


def weight_faults(element: ET.Element) -> tuple[str, ...]:
    """What is wrong with the masses of a `<robot>`'s links; empty when nothing is."""
    told = (f"{listed('link', names)} {what}" for names, what in _kinds(element) if names)
    return (*told, *_heavy(_masses(element)))


def unweighed(element: ET.Element) -> frozenset[str]:
    """The links of a `<robot>` whose masses have to be others, or to be there."""
    return frozenset(name for names, _ in _kinds(element) for name in names)


def _kinds(element: ET.Element) -> Iterator[tuple[list[str], str]]:
    """Links by what is wrong with them."""
    inertials, masses = _inertials(element), _masses(element)
    told = {name: inertial for name, inertial in inertials.items() if inertial is not None}
    yield (
        [name for name, inertial in inertials.items() if inertial is None],
        f"without <inertial>, for which the simulator would take 1 kg: give a mass and an inertia, {MEND}",
    )
    yield (
        [name for name, inertial in told.items() if _is_incomplete(inertial)],
        f"with an <inertial> that lacks <mass> or <inertia>, which the simulator refuses: give both, {MEND}",
    )
    yield (
        [name for name, inertial in told.items() if not _is_incomplete(inertial) and masses[name] is None],
        f"of a mass that is no number: give it in kg, {MEND}",
    )
    yield (
        [name for name, mass in masses.items() if mass is not None and mass < 0],
        f"of a negative mass: give it in kg, {MEND}",
    )
    yield (
        _massless(element, masses),
        "of mass 0, with all that fixed joints add: a joint that carries no mass stands still in the "
        f"simulator; give it in kg, {MEND}",
    )


def _is_incomplete(inertial: ET.Element) -> bool:
    return inertial.find("mass") is None or inertial.find("inertia") is None


def _massless(element: ET.Element, masses: Masses) -> list[str]:
    """The links of rigid pieces that weigh nothing.

    A joint along which nothing weighs stands still in Bullet, whatever its motor does; a frame of mass 0 that
    is fixed to what has a mass moves with it.
    """
    pieces = _pieces(element)
    heavy = {pieces[name] for name, mass in masses.items() if mass != 0}
    return [name for name in masses if pieces[name] not in heavy]


def _pieces(element: ET.Element) -> dict[str, str]:
    """For each link the one that stands for the rigid piece that fixed joints make of it and others."""
    pieces = {name: name for name in _inertials(element)}
    for joint, (parent, child) in zip(element.findall("joint"), edges(element), strict=True):
        if joint.get("type") == "fixed" and {parent, child} <= pieces.keys():
            old, new = pieces[child], pieces[parent]
            pieces = {name: new if piece == old else piece for name, piece in pieces.items()}
    return pieces


def _inertials(element: ET.Element) -> dict[str, ET.Element | None]:
    return {link.get("name", ""): link.find("inertial") for link in element.findall("link")}


def _masses(element: ET.Element) -> Masses:
    return {
        name: None if inertial is None else _mass(inertial) for name, inertial in _inertials(element).items()
    }


def _mass(inertial: ET.Element) -> float | None:
    mass = inertial.find("mass")
    try:
        return None if mass is None else float(mass.get("value", ""))
    except ValueError:
        return None


def _heavy(masses: Masses) -> Iterator[str]:
    total = sum(mass or 0.0 for mass in masses.values())
    if total > HEAVIEST:
        yield f"it weighs {total:.4g} kg, which looks like grams: masses are in kg, so multiply them by 0.001"
