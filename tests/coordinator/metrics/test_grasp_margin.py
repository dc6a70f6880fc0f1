"""Margins against closed forms, linear programs, whole hulls, and laws that hold for any grasp."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.rotation import Floats, unit
from qdgrasp_coordinator.metrics.grasp_margin import ball_radius, grasp_margins, primitive_wrenches

INRADIUS = np.cos(np.pi / 8)  # of an octagon, whose corners are at 1
TETRAHEDRON = unit(np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]))
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


@pytest.mark.parametrize("arm", [0.1, 0.3, 0.7])
def test_twelve_frictionless_contacts_on_a_cube_have_the_margin_of_the_closed_form(arm: float) -> None:
    """Two contacts on each face, `arm` aside: the wrenches are (+-e_i, +-arm e_j), the hull reaches
    max over i of |u_i| + arm |v_j|, and least for v alone, with three equal components."""
    sides = np.array([(axis, sign, side) for axis in range(3) for sign in (1, -1) for side in (1, -1)])
    points, normals = np.zeros((2, 12, 3))
    rows = np.arange(12)
    normals[rows, sides[:, 0]] = -sides[:, 1]
    points[rows, sides[:, 0]] = sides[:, 1]
    points[rows, (sides[:, 0] + 1) % 3] = arm * sides[:, 2]
    assert margin(points, normals, friction=0.0) == pytest.approx(arm / np.sqrt(3), abs=FLOAT32)


@pytest.mark.parametrize(("friction", "torsion"), [(0.5, 0.0), (1.0, 0.0), (0.5, 0.05), (1.0, 0.4)])
def test_linear_programs_come_down_to_the_margin_of_a_tetrahedron(friction: float, torsion: float) -> None:
    """The margin is 1 / the greatest |x| with w x <= 1 for all wrenches w. A program that maximises x y
    gives such an x, and the next with y = x a longer one: upper bounds of the margin, ever lower."""
    wrenches = primitive_wrenches(TETRAHEDRON, -TETRAHEDRON, friction, 1.0, torsion, 8).reshape(-1, 6)
    bounds = []
    for direction in np.random.default_rng(0).normal(size=(30, 6)):
        x, length = direction, 0.0
        while np.linalg.norm(x) > length + 1e-9 or not length:
            length = np.linalg.norm(x) if length else 1e-9
            x = linprog(-x, wrenches, np.ones(len(wrenches)), bounds=(None, None)).x
        bounds.append(1 / np.linalg.norm(x))
    found = margin(TETRAHEDRON, -TETRAHEDRON, friction, torsion=torsion)
    assert found > 0.05
    assert found == pytest.approx(min(bounds), abs=FLOAT32)


def test_the_pyramid_and_the_torsion_of_a_contact_lie_about_its_push() -> None:
    points, normals = on_ellipsoid(0, 5)
    wrenches = primitive_wrenches(points, normals, 0.5, 2.0, 0.1, 8)
    push = np.concatenate([normals, np.cross(points, normals) / 2.0], axis=1)
    np.testing.assert_allclose(wrenches[:, :8].mean(axis=1), push, atol=1e-12)
    np.testing.assert_allclose(wrenches[:, 8:].mean(axis=1), push, atol=1e-12)


@pytest.mark.parametrize("torsion", [0.0, 0.1])
@pytest.mark.parametrize("contacts", [4, 8])
def test_no_sampled_direction_is_reached_less_far_than_the_margin(contacts: int, torsion: float) -> None:
    """And the least of ever closer samples comes down to it in most grasps; in others, it ends above a
    facet that is farther away."""
    generator = np.random.default_rng(contacts)
    excesses = []
    for seed in range(10):
        wrenches = wrenches_of(seed, contacts, torsion)
        found = ball_radius(wrenches)
        worst, spread, least = np.zeros(6), 1.0, np.inf
        for count in [20_000] + 40 * [500]:
            directions = unit(worst + spread * generator.normal(size=(count, 6)))
            reached = (directions @ wrenches.T).max(axis=1)
            worst, spread, least = directions[reached.argmin()], spread * 0.8, min(least, reached.min())
        if found:
            assert least >= found - 1e-8
            excesses.append(least / found - 1)
        else:
            assert least <= 0
    assert len(excesses) >= 4
    assert np.median(excesses) < 0.1


@pytest.mark.parametrize("torsion", [0.0, 0.02])
@pytest.mark.parametrize("contacts", [3, 4, 6, 8])
def test_the_growing_hull_ends_at_the_nearest_facet_of_the_whole_hull(contacts: int, torsion: float) -> None:
    for seed in range(10):
        wrenches = wrenches_of(seed, contacts, torsion)
        whole = -ConvexHull(wrenches).equations[:, 6].max()
        assert ball_radius(wrenches) == pytest.approx(max(whole, 0.0), abs=1e-8)


@pytest.mark.parametrize(("tilt", "holds"), [(1.01, False), (0.9, True)])
def test_a_pair_slips_where_its_normals_lean_out_of_the_friction_cone(tilt: float, holds: bool) -> None:
    lean = np.arctan(0.5 * tilt)
    normals = np.array([[-np.cos(lean), 0.0, np.sin(lean)], [np.cos(lean), 0.0, np.sin(lean)]])
    found = margin(ANTIPODES, normals, friction=0.5, torsion=0.1)
    assert found > 0.0 if holds else found == 0.0


@pytest.mark.parametrize("contacts", [0, 1, 2, 3, 16])
def test_contacts_that_leave_a_wrench_unbalanced_have_no_margin(contacts: int) -> None:
    along = np.linspace(-1, 1, contacts)[:, None] * [[0.6, 0.0, 0.8]]
    across = np.tile([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], (8, 1))[:contacts]
    assert margin(along, across) == 0.0
    assert margin(along.astype(np.float32), across.astype(np.float32), friction=0.0, torsion=0.1) == 0.0


def test_contacts_in_one_place_are_as_good_as_one_of_them() -> None:
    points, normals = on_ellipsoid(3, 6)
    once = margin(points, normals)
    assert once > 0.0
    assert margin(np.repeat(points, 2, axis=0), np.repeat(normals, 2, axis=0)) == pytest.approx(
        once, abs=FLOAT32
    )


def test_an_eighth_of_a_turn_about_z_turns_the_pyramids_into_themselves() -> None:
    points, normals = on_ellipsoid(1, 6)
    found = margin(points, normals)
    assert found > 0.0
    for eighth in range(1, 8):
        turn = Rotation.from_euler("z", 45 * eighth, degrees=True).as_matrix().T
        assert margin(points @ turn, normals @ turn) == pytest.approx(found, abs=FLOAT32)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), contacts=st.integers(4, 8), torsion=st.sampled_from([0.0, 0.05]))
def test_turned_any_way_a_margin_stays_between_those_of_two_round_cones(seed, contacts, torsion) -> None:
    points, normals = on_ellipsoid(seed, contacts)
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    found = margin(points @ turn, normals @ turn, 0.5, torsion=torsion)
    round_cone = 1 / np.cos(np.pi / 32)  # a pyramid of 32 edges with this holds the cone
    assert found >= margin(points, normals, 0.5 * INRADIUS, torsion=torsion, edges=32) - FLOAT32
    assert found <= margin(points, normals, 0.5 * round_cone, torsion=torsion, edges=32) + FLOAT32


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), contacts=st.integers(3, 8), torsion=st.sampled_from([0.0, 0.05]))
def test_another_contact_more_friction_or_softer_fingers_never_lower_a_margin(seed, contacts, torsion):
    points, normals = on_ellipsoid(seed, contacts + 1)
    found = margin(points[1:], normals[1:], torsion=torsion)
    assert margin(points, normals, torsion=torsion) >= found - FLOAT32
    assert margin(points[1:], normals[1:], 0.6, torsion=torsion) >= found - FLOAT32
    assert margin(points[1:], normals[1:], torsion=torsion + 0.1) >= found - FLOAT32


def test_an_object_of_another_size_has_the_same_margin() -> None:
    points, normals = on_ellipsoid(2, 7)
    found = margin(points, normals, torsion=0.1)
    assert found > 0.0
    assert margin(0.037 * points, normals, radius=0.037, torsion=0.0037) == pytest.approx(found, abs=FLOAT32)


def test_grasps_of_one_table_are_alone_in_it_and_what_is_no_contact_is_not_read() -> None:
    generator = np.random.default_rng(0)
    points, normals = np.full((2, 12, 16, 3), np.nan, dtype=np.float32)
    touching = np.zeros((12, 16), dtype=bool)
    for grasp in range(12):
        places = np.sort(generator.permutation(16)[:grasp])
        touching[grasp, places] = True
        points[grasp, places], normals[grasp, places] = on_ellipsoid(grasp, grasp)
    found = grasp_margins(points, normals, touching, friction=0.5, radius=1.0)
    assert found.dtype == np.float32
    assert (found[:3] == 0).all()
    assert (found > 0).sum() >= 5
    alone = [margin(points[i, touching[i]], normals[i, touching[i]]) for i in range(12)]
    assert found.tolist() == alone
    assert grasp_margins(points[:0], normals[:0], touching[:0], friction=0.5, radius=1.0).shape == (0,)
