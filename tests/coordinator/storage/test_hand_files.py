"""Guessed files of hands: what is certain is written, what is not is asked."""

import pytest
from tests.assets import example_hands

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_coordinator.storage.hand_files import write_guess
from qdgrasp_protocol.errors import AssetError


def test_a_guess_is_said_and_is_a_gripper_with_a_copy_of_its_hand(tmp_path):
    urdf, target, said = tmp_path / "jaw.urdf", tmp_path / "run" / "jaw.toml", []
    urdf.write_text(example_hands.JAW_URDF.replace(example_hands.INERTIA, ""))
    write_guess(urdf, target, said.append)
    urdf.unlink()
    assert find_gripper(str(target)).file.finger_links == ("left", "right")
    assert [line.split("  ")[0] for line in said[-1].splitlines()] == [
        "hand", "base link", "approach", "fingers", "closes",
    ]  # fmt: skip


def test_a_robot_with_two_hands_is_asked_which_and_nothing_is_written(tmp_path):
    urdf, target = tmp_path / "two.urdf", tmp_path / "two.toml"
    hand = example_hands.JAW_URDF.partition("\n")[2].rpartition("</robot>")[0]
    sides = []
    for side, way in (("l_", -1), ("r_", 1)):
        named = hand
        for name in ("palm", "left", "right", "slide", "other"):
            named = named.replace(f'"{name}"', f'"{side}{name}"')
        ends = f'<parent link="torso"/><child link="{side}palm"/><origin xyz="{way} 0 0"/>'
        sides.append(f'{named}<joint name="{side}arm" type="fixed">{ends}</joint>')
    urdf.write_text(f'<robot name="two"><link name="torso"/>{"".join(sides)}</robot>')
    with pytest.raises(AssetError, match=r"l_palm or r_palm: --base-link"):
        write_guess(urdf, target, lambda _: None)
    assert [*tmp_path.iterdir()] == [urdf]
