"""Units and scales of mesh files."""

import pytest

from qdgrasp_assets.units import UNITS, advice, in_words, scale_of
from qdgrasp_protocol.errors import ImpossibleValue, InputError, UnknownName


def test_a_unit_is_a_scale():
    assert {unit: scale_of(unit, None) for unit in UNITS} == {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
    assert scale_of(None, 0.3) == 0.3
    assert scale_of(None, None) is None


def test_a_unit_and_a_scale_at_once_are_refused():
    with pytest.raises(InputError, match=r"--units mm means --scale 0\.001: give only one"):
        scale_of("mm", 2.0)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), 1e7])
def test_a_scale_that_no_mesh_has_is_refused(scale):
    with pytest.raises(
        ImpossibleValue, match=r"--scale must be a number greater than 0 and at most 1000000 .*got"
    ):
        scale_of(None, scale)


def test_an_unknown_unit_is_answered_with_those_that_are_known():
    with pytest.raises(UnknownName, match=r"Unknown unit 'furlong'\. Known: cm, in, m, mm\."):
        scale_of("furlong", None)


@pytest.mark.parametrize(
    ("largest", "words"),
    [
        (120.0, "it looks like millimetres: add --units mm"),
        (
            5.0,
            "it looks like millimetres or centimetres or inches: add --units mm or --units cm or --units in",
        ),
        (3e6, "say how many metres a unit of the file is with --scale"),
        (1e-4, "say how many metres a unit of the file is with --scale"),
    ],
)
def test_what_a_drawing_looks_like_follows_from_its_size(largest, words):
    assert advice(largest) == words


def test_a_scale_is_told_as_the_flag_that_means_it():
    assert [in_words(scale) for scale in (0.001, 0.0254, 1.0, 0.5)] == [
        "--units mm",
        "--units in",
        "--units m",
        "--scale 0.5",
    ]
