"""How a hand grips, as files say it."""

import numpy as np
import pytest

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_tools.export.grip import jaw_widths, squeeze_targets
from qdgrasp_worker.physical_episode import FingerControl, finger_drives


@pytest.mark.parametrize(("name", "label"), [("panda", NO_SYNERGY), ("barrett", NO_SYNERGY), ("allegro", 1)])
def test_squeeze_targets_are_those_of_drives_that_stall_at_the_grasp(name: str, label: int) -> None:
    hand = find_gripper(name).on_carrier("physical")
    robot, names = scene_robot(hand), [joint.name for joint in hand.joints]
    drives = finger_drives(hand, [robot.joint(each) for each in names], [0.1] * len(names), 2.0)
    starts = np.array([joint.opened for joint in hand.joints])
    stalled = starts + 0.4 * (np.array([drive.closed for drive in drives]) - starts)
    control = FingerControl(drives, is_coupled=hand.jaw is not None)
    driven = [joint.name for joint in hand.joints if joint.driven]
    closing = driven if label == NO_SYNERGY else hand.synergies[label].joints
    control.start(starts.tolist(), closing)
    for _ in range(2000):
        targets = control.walk(stalled.tolist(), 1 / 480)
    found = squeeze_targets(hand, "physical", starts[None], stalled[None], np.array([label]))
    expected = np.where(np.isin(names, closing), targets, stalled)
    np.testing.assert_allclose(found[0], expected, atol=1e-6)
    limits = [drive.limit * (0.5 if hand.jaw else 1.0) * (drive.name in closing) for drive in drives]
    forces = [abs(each.stiffness * way) for each, way in zip(drives, found[0] - stalled, strict=True)]
    np.testing.assert_allclose(forces, limits, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["panda", "robotiq_2f"])
def test_a_jaw_is_as_wide_as_its_opening_when_open_and_closes_to_nothing(name: str) -> None:
    hand = find_gripper(name).on_carrier("physical")
    ends = np.array([[joint.opened for joint in hand.joints], [joint.closed for joint in hand.joints]])
    widths = jaw_widths(hand, [*ends, ends.mean(axis=0)])
    np.testing.assert_allclose(widths[:2], [hand.jaw.opening, 0.0], atol=1e-6)
    assert 0.01 < widths[2] < 0.05
