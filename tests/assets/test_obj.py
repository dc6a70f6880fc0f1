"""OBJ files."""

import numpy as np
import pytest

from qdgrasp_assets.obj import read_obj

SQUARES = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1/1 2/2/2 3//3 4
g none
o two
v 0 0 1
f -1 -3 -2
"""


def test_a_face_of_four_corners_is_two_triangles_and_negative_numbers_count_from_the_end() -> None:
    read = read_obj(SQUARES)
    one, two = read.groups
    np.testing.assert_array_equal(one, [(0, 1, 2), (0, 2, 3)])
    np.testing.assert_array_equal(two, [(4, 2, 3)])
    assert read.vertices.shape == (5, 3)


def test_only_the_words_that_are_named_begin_a_group() -> None:
    assert len(read_obj("v 0 0 0\nf 1 1 1\no a\nf 1 1 1\ng b\nf 1 1 1\n", frozenset({"o"})).groups) == 2


@pytest.mark.parametrize("text", ["v zero 0 0\n", "v 0 0 0\nf a b c\n"])
def test_what_is_no_obj_file_is_an_error(text) -> None:
    with pytest.raises(ValueError, match=r"could not convert|invalid literal"):
        read_obj(text)
