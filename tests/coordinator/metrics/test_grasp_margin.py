"""Margins against closed forms, linear programs, whole hulls, and laws that hold for any grasp."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from qdgrasp_assets.geometry.rotation import Floats, unit
from qdgrasp_coordinator.metrics.grasp_quality import ball_radius, grasp_margins, primitive_wrenches

INRADIUS = np.cos(np.pi / 8)  # of an octagon, whose corners are at 1
ANTIPODES = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
FLOAT32 = 1e-7  # Margins are below 1


def margin(
    points: Floats,
    normals: Floats,
    friction: float = 0.5,
    radius: float = 1.0,
    torsion: float = 0.0,
    edges: int = 8,
) -> float:
    touching = np.ones((1, len(points)), dtype=bool)
    found = grasp_margins(
        points[None], normals[None], touching, friction=friction, radius=radius, torsion=torsion, edges=edges
    )
    return float(found[0])


def on_ellipsoid(seed: int, contacts: int) -> tuple[Floats, Floats]:
    """Random contacts (c, 3) on an ellipsoid of greatest radius 1, and its normals inwards."""
    axes = np.array([1.0, 0.6, 0.5])
    directions = unit(np.random.default_rng(seed).normal(size=(contacts, 3)))
    return directions * axes, -unit(directions / axes)


def wrenches_of(seed: int, contacts: int, torsion: float = 0.0) -> Floats:
    return primitive_wrenches(*on_ellipsoid(seed, contacts), 0.5, 1.0, torsion, 8).reshape(-1, 6)


def test_two_opposing_point_contacts_cannot_balance_a_torque_about_their_line() -> None:
    assert margin(ANTIPODES, -ANTIPODES, friction=2.0) == 0.0


@pytest.mark.parametrize("radius", [0.02, 1.0])
@pytest.mark.parametrize(("friction", "torsion"), [(0.5, 0.1), (0.2, 0.15), (0.3, 0.5), (1.0, 5.0)])
def test_two_opposing_soft_contacts_have_the_margin_of_the_closed_form(friction, torsion, radius) -> None:
    """The worst wrench is sideways and about the line at once, or sideways and along it.

    Along u = (a force along the line, c and d its lateral parts at the contacts, a torque q about it), with
    u^2 = a^2 + (c^2 + d^2) / 2 + q^2, the hull reaches max(max(kc, mq) - a, max(kd, mq) + a) for corners of
    the octagon that are least favourable, k = friction * INRADIUS. The least of it for u = 1 is at a = 0, or
    at d = q = 0.
    """
    k = friction * INRADIUS
    expected = 1 / np.sqrt(max(1 / k**2 + 1 / torsion**2, 1 + 2 / k**2))
    found = margin(radius * ANTIPODES, -ANTIPODES, friction, radius, torsion * radius)
    assert found == pytest.approx(expected, abs=FLOAT32)


@pytest.mark.parametrize("torsion", [0.0, 0.02])
@pytest.mark.parametrize("contacts", [3, 4, 6, 8])
def test_the_growing_hull_ends_at_the_nearest_facet_of_the_whole_hull(contacts: int, torsion: float) -> None:
    for seed in range(10):
        wrenches = wrenches_of(seed, contacts, torsion)
        whole = -ConvexHull(wrenches).equations[:, 6].max()
        assert ball_radius(wrenches) == pytest.approx(max(whole, 0.0), abs=1e-8)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), contacts=st.integers(3, 8), torsion=st.sampled_from([0.0, 0.05]))
def test_another_contact_more_friction_or_softer_fingers_never_lower_a_margin(seed, contacts, torsion):
    points, normals = on_ellipsoid(seed, contacts + 1)
    found = margin(points[1:], normals[1:], torsion=torsion)
    assert margin(points, normals, torsion=torsion) >= found - FLOAT32
    assert margin(points[1:], normals[1:], 0.6, torsion=torsion) >= found - FLOAT32
    assert margin(points[1:], normals[1:], torsion=torsion + 0.1) >= found - FLOAT32
