"""Scenes' files: bodies around an object as convex parts, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec

APART = "[[body]]\nbox = [0.1, 0.2, 0.3]\nposition = [1.0, 0.0, 0.0]\n"


def bounds(folder: Path, text: str, **more: str) -> np.ndarray:
    """The low and high corner (p, 2, 3) [m] of each part around the cube, in the frame of its mesh."""
    (folder / "scene.toml").write_text(text)
    values = {"gripper": "panda", "object": "rubiks_cube", "protocol": "physical"} | more
    scene = build_scene(RunSpec(**values, scene=str(folder / "scene.toml")))
    return (
        np.array([part.bounds for part in parse_parts(scene.neighbours.decode())]) + scene.object.com_in_mesh
    )


def test_boxes_meshes_and_objects_stand_where_the_file_says(tmp_path):
    trimesh.creation.box((100.0, 20.0, 40.0)).export(tmp_path / "part.stl")
    turned = "[[body]]\nmesh = 'part.stl'\nscale = 0.001\nposition = [0.0, 0.5, 0.0]\n"
    half = "[[body]]\nobject = 'cracker_box'\nposition = [0.0, -0.5, 0.0]\nquaternion = [0, 0, 2, 0]\n"
    found = bounds(tmp_path, APART + turned + "rpy = [0.0, 0.0, 1.5707963]\n" + half)
    expected = [
        [[0.95, -0.1, -0.15], [1.05, 0.1, 0.15]],
        [[-0.01, 0.45, -0.02], [0.01, 0.55, 0.02]],
        [[-0.0155, -0.566, -0.0124], [0.0445, -0.406, 0.2176]],
    ]
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (APART.replace("1.0", "0.0"), "body 1 in .* overlaps the object"),
        (APART + "[[body]]\nbox = [0.01, 0.01, 0.01]\nposition = [0, 0, 0.02]\n", "body 2 in .* overlaps"),
        ("[[body]]\nmesh = 'absent.stl'\n", "No mesh file at .*absent.stl"),
        ("[[body]]\nobject = 'mugs'\n", "Unknown object 'mugs'"),
        ("[[body]]\nposition = [1.0, 0.0, 0.0]\n", "one of mesh, object and box"),
        (APART * 51, "no scene's file: .* length <= 50"),
        (APART + "colour = 'red'\n", "unknown field `colour`"),
        (APART.replace("1.0", "nan"), "numbers are finite, got nan"),
        ("", "no scene's file"),
    ],
)
def test_a_scene_that_cannot_be_is_refused_in_one_sentence(text, words, tmp_path):
    with pytest.raises(InputError, match=words):
        bounds(tmp_path, text)


def test_a_hand_that_is_shaken_has_no_neighbours(tmp_path):
    with pytest.raises(InputError, match="must be physical or lift, got 'paper'"):
        bounds(tmp_path, APART, protocol="paper")
