from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from qdgrasp_assets.carrier import CARRIERS
from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.urdf import read_urdf, tree
from qdgrasp_protocol.errors import AssetError

REFERENCE = ("ref_allegro", "ref_bh280", "ref_panda_2f", "ref_robotiq_2f", "ref_shadow")


def carried(name: str, protocol: str):
    hand = find_gripper(name).on_carrier(protocol)
    return hand, tree(Path(name), ElementTree.fromstring(hand.urdf))  # noqa: S314


def assert_base_is_root_at_zero(name: str, protocol: str) -> None:
    hand, robot = carried(name, protocol)
    assert robot.root != hand.base_link
    assert robot.forward({})[hand.base_link] == pytest.approx(np.eye(4))
    assert {joint.name for joint in hand.carrier} <= {joint.name for joint in robot.joints}


@pytest.mark.parametrize("protocol", CARRIERS)
def test_the_hand_is_at_the_root_when_the_carrier_is_at_zero(protocol):
    assert_base_is_root_at_zero("panda", protocol)


@pytest.mark.parametrize("protocol", CARRIERS)
@pytest.mark.parametrize("name", REFERENCE)
def test_a_reference_hand_is_at_the_root_when_the_carrier_is_at_zero(asset_path, name, protocol):
    assert_base_is_root_at_zero(name, protocol)


@pytest.mark.parametrize("protocol", CARRIERS)
def test_shakes_move_the_hand_along_its_z_and_about_its_x(protocol):
    hand, robot = carried("panda", protocol)
    shaken = {joint.shake: joint.name for joint in hand.carrier if joint.shake}
    frame = robot.forward({shaken["z"]: 0.2, shaken["x"]: np.pi / 2})[hand.base_link]
    assert frame[:3, 3] == pytest.approx([0, 0, 0.2])
    assert frame[:3, 1] == pytest.approx([0, 0, 1])


def test_the_panda_has_the_forces_of_the_experiment():
    for protocol in CARRIERS:
        hand, _ = carried("panda", protocol)
        shakes = {joint.shake: joint.shake_force for joint in hand.carrier if joint.shake}
        assert shakes == {"z": 20.0, "x": 100.0}
        assert {joint.force for joint in hand.carrier} == {100.0}


def test_paper_pushes_every_hand_with_the_pandas_acceleration(asset_path):
    for name in REFERENCE:
        hand, robot = carried(name, "paper")
        force = next(joint.shake_force for joint in hand.carrier if joint.shake == "z")
        moved = robot.mass - 3.0  # the root does not move
        assert force / moved == pytest.approx(20.0 / 3.7, rel=1e-6)


def test_released_keeps_a_reference_hand_as_its_file_has_it(asset_path):
    _, robot = carried("ref_panda_2f", "released")
    original = read_urdf(asset_path / "grippers/panda_2f/panda_2f.urdf")
    assert robot.links == original.links
    for kept, given in zip(robot.element.findall("joint"), original.element.findall("joint"), strict=True):
        assert [part.attrib for part in kept.iter()] == [part.attrib for part in given.iter()]
    for kept, given in zip(robot.element.iter("inertial"), original.element.iter("inertial"), strict=True):
        assert [part.attrib for part in kept.iter()] == [part.attrib for part in given.iter()]


def test_released_gives_a_hand_without_a_carrier_the_links_of_the_reference():
    _, robot = carried("panda", "released")
    assert [joint.name for joint in robot.joints][:6] == [
        "translationX",
        "translationY",
        "translationZ",
        "rotationX",
        "rotationY",
        "rotationZ",
    ]
    assert robot.mass == pytest.approx(6.7)


def test_the_shadows_carrier_is_held_harder(asset_path):
    hand, _ = carried("ref_shadow", "released")
    assert {joint.force for joint in hand.carrier} == {1000.0}


def test_a_name_that_the_carrier_needs_is_refused(claw, edit):
    for file in ("claw.urdf", "claw.toml"):
        edit(claw.parent / file, "bend", "rotationX")
    with pytest.raises(AssetError, match="uses the name 'rotationX', which the carrier needs"):
        find_gripper(str(claw)).on_carrier("paper")
