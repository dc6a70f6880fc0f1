"""The cover: the whole surface is in it, and it is bounded however large the object is."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from qdgrasp_worker.convex import hulls
from qdgrasp_worker.cover import Cover, coarseness
from qdgrasp_worker.solid import Solid

SIZES = [(0.3, 0.3, 0.3), (0.6, 0.6, 0.6), (1.5, 1.5, 1.5), (2.0, 2.0, 0.002), (2.0, 0.01, 0.01)]


def box(*size):
    """What a cover takes of a solid that is a box."""
    return SimpleNamespace(hulls=hulls([np.array(list(product((-0.5, 0.5), repeat=3))) * size]))


def assert_covers(cover, solid):
    random = np.random.default_rng(0)
    triangles = np.concatenate([hull.triangles for hull in solid.hulls])
    some = triangles[random.integers(len(triangles), size=400)]
    points = (random.dirichlet((1.0, 1.0, 1.0), len(some))[:, :, None] * some).sum(axis=1)
    for balls in (cover.large, cover.small):
        for point in points:
            assert (balls.radii - np.linalg.norm(point - balls.centres, axis=1)).max() > -1e-9
    assert cover.counts.sum() == len(cover.small.centres)


def assert_gathers(cover):
    """Each large ball holds its small ones."""
    around = np.repeat(np.arange(len(cover.counts)), cover.counts)
    apart = np.linalg.norm(cover.large.centres[around] - cover.small.centres, axis=1)
    assert (apart + cover.small.radii <= cover.large.radii[around] + 1e-9).all()


@pytest.mark.parametrize("target", ["rubiks_cube", "mug", "bowl", "spatula"])
def test_the_cover_of_an_object_for_a_hand_is_fine_and_holds_the_whole_surface(target, make_scene):
    solid = Solid(make_scene("panda", target, "paper"))
    cover = Cover.of(solid)
    assert coarseness(solid) == 1.0
    assert cover.small.radii.max() < 5e-3
    assert_covers(cover, solid)
    assert_gathers(cover)


@pytest.mark.parametrize("size", SIZES)
def test_a_large_object_is_covered_by_no_more_balls_than_one_of_a_third_of_a_metre(size):
    solid = box(*size)
    cover = Cover.of(solid)
    assert len(cover.small.centres) < 75_000
    assert len(cover.large.centres) < 4_000
    assert_covers(cover, solid)
    assert_gathers(cover)
