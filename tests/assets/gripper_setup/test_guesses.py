"""Guesses of hands that are easily guessed wrong: synthetic ones, and public ones where they are at hand."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from tests.assets import synthetic_hands
from tests.assets.example_hands import INERTIA, JAW_URDF, LINKAGE_URDF

from qdgrasp_assets.asset_report import examine_hand
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper
from qdgrasp_assets.gripper_setup.posture_checks import HandPostures, depth_at
from qdgrasp_assets.gripper_setup.repaired_copy import centre_base, repair
from qdgrasp_assets.grippers.hand_model import followers, read_hand_model
from qdgrasp_assets.grippers.urdf import parse_robot, read_urdf
from qdgrasp_assets.grippers.urdf_checks import hand_faults


class Guess:
    """A guessed hand, and the faults that checks find in it."""

    def __init__(self, urdf: Path, **told):
        robot = read_urdf(urdf)
        self.draft = draft_gripper(robot, urdf.name, DraftOverrides(**told))
        self.file, self.warnings = self.draft.file, self.draft.warnings
        self.found = examine_hand(robot, self.file, "hand")
        self.postures = HandPostures(self.file, read_hand_model(robot, self.file.base_link))

    @property
    def closing(self):
        """The joints that close."""
        return {name for name, table in self.file.joints.items() if table.closed is not None}


@pytest.fixture
def guess(tmp_path):
    """The guesses from the text of a URDF."""

    def made(text, **told):
        (tmp_path / "hand.urdf").write_text(text)
        return Guess(tmp_path / "hand.urdf", **told)

    return made


BENDING = {f"{name}_{part}" for name in synthetic_hands.NAMES for part in ("bend", "curl", "tip")}


@pytest.mark.parametrize("text", [synthetic_hands.THUMB_HAND, synthetic_hands.HALVED_HAND])
def test_joints_that_bend_fingers_close_and_those_that_spread_them_do_not(guess, text):
    found = guess(text)
    assert found.closing == BENDING | {"thumb_curl", "thumb_tip"}
    for name in BENDING:
        assert found.file.joints[name].open == 0.0
        assert found.file.joints[name].closed > 0.2
    assert all(found.file.joints[f"{name}_spread"].open == 0.0 for name in synthetic_hands.NAMES)
    assert found.file.approach_axis == (0.0, 1.0, 0.0)


def test_a_thumb_is_turned_out_of_the_palm_and_bends_toward_the_fingers(guess):
    found = guess(synthetic_hands.THUMB_HAND)
    assert found.file.joints["thumb_turn"].open == pytest.approx(np.pi / 2, abs=0.5)
    assert (found.file.joints["thumb_curl"].open, found.file.joints["thumb_tip"].open) == (0.0, 0.0)
    assert found.file.joints["thumb_curl"].closed > 0.1
    assert (found.found.faults, found.warnings) == ((), ())
    assert [synergy.name for synergy in found.file.synergies] == ["thumb_1", "thumb_2", "thumb_3", "all"]


def assert_meets_and_goes_no_farther(found, one, other):
    """Two links overlap by no more than the limit, and by more with joints 5 % further."""
    depths = [depth_at(found.postures, one, other, share) for share in (1.0, 1.05)]
    assert depths[0] < 2e-3 <= depths[1]


@pytest.mark.parametrize("mimics", [False, True])
def test_fingers_stop_where_they_meet_and_followers_with_their_leader(guess, mimics):
    found = guess(synthetic_hands.claw(mimics=mimics))
    left, right = (found.file.joints[name].closed for name in ("left", "right"))
    assert left == right
    assert 0.2 < left < 0.8
    assert_meets_and_goes_no_farther(found, "left_finger", "right_finger")
    assert "closes to where 'left_finger' meets 'right_finger'" in found.draft.reasons["joints.left"]


def test_joints_are_told_not_to_close(guess):
    found = guess(synthetic_hands.claw(), not_closing=("right",))
    assert found.closing == {"left"}
    assert found.draft.reasons["joints.right"] == "does not close, as told"
    (warning,) = (words for words in found.warnings if "nothing closes the finger" in words)
    assert "'right_finger'" in warning
    assert "--finger LINK" in warning


LIMITS = 'lower="-0.04" upper="0"'


def test_every_joint_closes_over_its_whole_range_whatever_its_digits(guess):
    pairs = np.sort(np.random.default_rng(4).integers(-4000, 4000, (40, 2)), axis=1) / 1e5
    ranges = [(low, high) for low, high in pairs.tolist() if low + (high - low) != high]
    assert len(ranges) > 5
    for low, high in ranges:
        turned = JAW_URDF.replace('xyz="0 1 0"', 'xyz="0 -1 0"', 1).replace('<mimic joint="slide"/>', "")
        tables = guess(turned.replace(LIMITS, f'lower="{low}" upper="{high}"')).file.joints
        assert (tables["slide"].open, tables["other"].open) == (low, high)
        assert tables["slide"].closed > low


def single_jaw(sense, widest, length):
    """A jaw that turns by -0.15 to `widest` toward one that is a shape of the palm; limits by `sense`."""
    limits = sorted((-0.15 * sense, widest * sense))
    pad, size = f"0 -0.014 {0.06 + length / 2}", f"0.02 0.012 {length}"
    palm = synthetic_hands.link("palm", "0.05 0.1 0.06", "0 0 0.03")
    fixed = f'<collision><origin xyz="{pad}"/><geometry><box size="{size}"/></geometry></collision></link>'
    return (
        palm.replace("</link>", fixed),
        synthetic_hands.hinge("bite", ("palm", "jaw"), "0 0.008 0.06", f"{-sense} 0 0", tuple(limits)),
        synthetic_hands.link("jaw", size, f"0 0 {0.005 + length / 2}"),
    )


@pytest.mark.parametrize(("sense", "widest", "length"), [(1, 1.6, 0.09), (-1, 1.2, 0.06), (1, 0.9, 0.11)])
@pytest.mark.parametrize("segments", [0, 5])
def test_a_jaw_closes_on_a_shape_of_the_palm_also_at_the_end_of_an_arm(
    guess, sense, widest, length, segments
):
    links = [name for number in range(segments) if (name := f"segment_{number}")] + ["palm"]
    arm = [
        synthetic_hands.link(one)
        + synthetic_hands.hinge(f"axis_{one}", (one, other), "0 0 0.04", axis, (-1.9, 1.9))
        for one, other, axis in zip(links, links[1:], ("0 0 1", "0 1 0") * 3, strict=False)
    ]
    found = guess(synthetic_hands.robot(*arm, *single_jaw(sense, widest, length)))
    table = found.file.joints["bite"]
    assert found.file.base_link == "palm"
    assert (table.open, -0.15 <= table.closed * sense <= 0) == (widest * sense, True)
    assert found.file.approach_axis == (0.0, 0.0, 1.0)
    assert found.found.faults == ()
    centred = centre_base(found.postures.body.robot, "palm", DraftOverrides())
    assert centred.robot.forward({})["palm"][1, 3] < -0.01  # away from the fixed jaw


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("axis", ["0 0 1", "1 0 0"])
def test_fingers_that_follow_a_motor_without_a_finger_are_closed_by_it(guess, axis, sense):
    limits = tuple(sorted((0.0, 1.5 * sense)))
    motor = synthetic_hands.hinge("pull", ("palm", "motor"), "0 0 0", axis, limits)
    inertial = f'<link name="motor"><inertial><mass value="0.1"/>{INERTIA}</inertial></link></robot>'
    text = synthetic_hands.claw(mimics=True).replace("</robot>", motor + inertial)
    mimic = f'<mimic joint="pull" multiplier="{0.2 * sense}" offset="0.1"/></joint>'
    text = text.replace('velocity="8"/></joint>', f'velocity="8"/>{mimic}', 1)
    found = guess(text)
    low, high = (found.postures.posture(share)["left"] for share in (0.0, 1.0))
    assert "pull" in found.closing
    assert low == pytest.approx(0.1)
    assert 0.2 < high <= 0.4
    assert found.found.faults == found.warnings == ()


@pytest.mark.parametrize("link", ["palm", "left", "right"])
def test_a_link_with_a_visual_shape_alone_is_warned_of_and_repaired(guess, tmp_path, link):
    head, tail = JAW_URDF.split(f'<link name="{link}">')
    text = f'{head}<link name="{link}">{tail.replace("collision>", "visual>", 2)}'
    assert any(f"objects pass: {link};" in words for words in guess(text).warnings)
    changed = repair(read_urdf(tmp_path / "hand.urdf"), "palm", "meshes", lambda _: None)[0]
    assert ET.tostring(changed.find(f"link[@name='{link}']/collision")).strip().endswith(b"</collision>")


@pytest.mark.parametrize(
    ("text", "low", "high", "scale", "unit"),
    [
        (JAW_URDF, '"-0.04"', '"-40"', 0.001, "millimetres"),
        (LINKAGE_URDF, "0.7", "40", np.pi / 180, "degrees"),
    ],
)
def test_limits_in_other_units_are_refused_and_converted(tmp_path, text, low, high, scale, unit):
    urdf = tmp_path / "hand.urdf"
    urdf.write_text(text.replace(low, high).replace("<mimic ", f'<mimic offset="{0.001 / scale}" '))
    robot = read_urdf(urdf)
    assert any(unit in fault and "--repair" in fault for fault in hand_faults(robot))
    copy = parse_robot(urdf, repair(robot, "palm", "meshes", lambda _: None)[0])
    for before, after in zip(robot.joints, copy.joints, strict=True):
        assert (after.lower, after.upper) == pytest.approx((before.lower * scale, before.upper * scale))
    assert {each.offset for each in followers(copy).values()} == {0.001}
    assert hand_faults(copy) == ()


@pytest.mark.parametrize("low", [0.0, 0.35, 0.5])
def test_a_crank_opens_to_its_limit_wherever_its_zero_is(guess, low):
    text = LINKAGE_URDF.replace("-0.7", f"{low - 0.7}").replace('"0.7"', f'"{0.7 - low}"')
    turned = text.replace('lower="0"', f'lower="{-low}"').replace('upper="0"', f'upper="{low}"')
    assert guess(turned).file.joints["knuckle"].open == -low
