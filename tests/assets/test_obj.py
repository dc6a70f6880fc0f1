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


@pytest.mark.parametrize(
    ("line", "groups"),
    [
        ("o b", 2),
        ("g b", 2),
        (" \tg\tb", 2),
        ("o ", 2),
        ("g", 1),
        ("usemtl b", 1),
        ("s 2", 1),
        ("object b", 1),
    ],
)
def test_objects_and_groups_begin_another_group_and_materials_do_not(line, groups) -> None:
    assert len(read_obj(f"v 0 0 0\no a\nf 1 1 1\n{line}\nf 1 1 1\n").groups) == groups


@pytest.mark.parametrize("text", ["v zero 0 0\n", "v 0 0 0\nf a b c\n"])
def test_what_is_no_obj_file_is_an_error(text) -> None:
    with pytest.raises(ValueError, match=r"could not convert|invalid literal"):
        read_obj(text)
