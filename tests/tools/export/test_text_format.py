from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from tests.tools.export.foreign_files import ISAAC, check_pose, check_refusal

from qdgrasp_tools.export import text_format
from qdgrasp_tools.export.text_format import shortest_decimals, table_decimals

TABLES = [
    arrays.arrays(np.float32, (1, 3), elements=st.floats(width=32, allow_nan=False, allow_infinity=False)),
    arrays.arrays(np.float64, (1, 3), elements=st.floats(-1e6, 1e6)),
]


@given(st.one_of(TABLES))
def test_decimals_give_back_every_bit(table: np.ndarray) -> None:
    read = np.array([yaml.safe_load(f"[{', '.join(line)}]") for line in table_decimals(table)])
    assert read.dtype == np.float64
    assert read.astype(table.dtype).tobytes() == table.tobytes()


def test_a_table_without_columns_has_empty_lines() -> None:
    assert table_decimals(np.zeros((2, 0))) == [[], []]


def test_decimals_are_as_short_as_can_be_with_a_point_and_without_an_exponent() -> None:
    numbers = [0.0, -0.0, 2.0, 1e-7, -1.5e-5, 1e16, 0.1, np.nan, -np.inf]
    expected = ["0.0", "-0.0", "2.0", "0.0000001", "-0.000015", "10000000000000000.0", "0.1", "nan", "-inf"]
    assert shortest_decimals(np.array(numbers)) == expected
    assert shortest_decimals(np.array([0.1, 1e-5, 3.0], np.float32)) == ["0.1", "0.00001", "3.0"]


BOMB = "a: &a [x, x]\nb: &b [*a, *a]\nformat: isaac_grasp\n"
JOINT = "      panda_finger_joint1"
POSITION_LINE = "    position: [0.1, -0.2, 0.3]\n"
BAD_YAML = {
    "aliases": (BOMB, "anchors, aliases and tags are not read"),
    "a tag": ("a: !!python/object/apply:os.system [ls]\n", "anchors, aliases and tags are not read"),
    "depth": ("a: " + "[" * 50_000, "nested more than 16 levels deep"),
    "no YAML": ("a: [1, 2\nb: }", "it is not YAML (line 2"),
    "two documents": ("a: b\n---\na: b\n", "it must be one YAML document, and is 2"),
    "a list as a key": ("[a]: b\n", "a key must be a word"),
    "a key twice": ("a: b\na: c\n", "'a' stands there twice"),
    "other YAML": ("a: b\n", "not an Isaac grasp file"),
    "words": ("hello\n", "not an Isaac grasp file"),
    "another version": (ISAAC.replace("1.0\n", "2.0\n", 1), "it is of format version 2.0; 1.0 is read"),
    "no version": (ISAAC.replace("format_version: 1.0\n", ""), "format_version must be a number"),
    "no grasps": (ISAAC[: ISAAC.index("grasps:\n")], "its key 'grasps' must hold grasps by name"),
    "an empty list": (ISAAC[: ISAAC.index("grasps:\n")] + "grasps: {}\n", "there is none in it"),
    "no position": (ISAAC.replace(POSITION_LINE, ""), "grasp 0: position must be 3 numbers"),
    "two numbers": (ISAAC.replace("0.1, -0.2, 0.3", "0.1, -0.2"), "grasp 0: position must be 3 numbers"),
    "a word": (ISAAC.replace("0.1, -0.2", "x, -0.2"), "grasp 0: position must be 3 numbers"),
    "a mapping": (ISAAC.replace("0.1, -0.2", "{a: b}, -0.2"), "grasp 0: position must be 3 numbers"),
    "NaN": (ISAAC.replace("0.1, -0.2", "nan, -0.2"), "of grasp 'grasp 0' its pose holds"),
    "infinity": (ISAAC.replace("0.1, -0.2", "1e999, 0"), "its pose holds a number that is not finite"),
    "zero quaternion": (
        ISAAC[: ISAAC.index("    orientation")] + "    orientation: {w: 0.0, xyz: [0, 0, 0]}\n",
        "'grasp 0' its quaternion must be of length 1, and is of length 0",
    ),
    "joints in a list": (ISAAC.replace(f"\n{JOINT}: 0.02", " [1]"), "must hold joints by name"),
    "an infinite joint": (ISAAC.replace(": 0.04", ": .inf"), "joint1 must be a number"),
    "a grasp that is none": (ISAAC + "  other: 3\n", "other: position must be 3 numbers"),
    "very many joints": (
        ISAAC + "".join(f"      joint{number}: 0\n" for number in range(1000)),
        "pregrasp_cspace_position: there are more than 1000 joints",
    ),
    "a long name": (ISAAC.replace("grasp 0", "a" * 201), "a name is longer than 200 letters"),
    "far away": (ISAAC.replace("0.1, -0.2", "1e30, -0.2"), "'grasp 0' its position is more than 1000 m away"),
    "a block that is not ours": (ISAAC + "qdgrasp: {frame: x}\n", "its block 'qdgrasp' cannot be read"),
}


@pytest.mark.parametrize(("text", "why"), BAD_YAML.values(), ids=BAD_YAML)
def test_yaml_that_tells_no_grasps_is_refused_in_a_sentence(panda, tmp_path, text, why) -> None:
    (tmp_path / "f.yaml").write_text(text)
    check_refusal(panda, tmp_path / "f.yaml", why)


def test_yaml_in_the_pure_parser_is_refused_alike(panda, tmp_path, monkeypatch) -> None:
    """PyYAML may be built without libyaml."""
    monkeypatch.delattr(yaml, "CSafeLoader")
    (tmp_path / "f.yaml").write_text(ISAAC)
    check_pose(panda(tmp_path / "f.yaml"))
    for text, why in (BAD_YAML["aliases"], BAD_YAML["depth"]):
        (tmp_path / "f.yaml").write_text(text[:4000])
        check_refusal(panda, tmp_path / "f.yaml", why)


def test_a_file_that_is_too_large_is_refused(panda, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_format, "LARGEST_YAML", 100)
    (tmp_path / "f.yaml").write_text(ISAAC)
    check_refusal(panda, tmp_path / "f.yaml", "it is larger than")
