"""Guesses of hands that are easily guessed wrong: synthetic ones, and public ones where they are at hand."""

from pathlib import Path

import numpy as np
import pytest
from tests.assets import synthetic_hands

from qdgrasp_assets.asset_report import examine_hand
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper
from qdgrasp_assets.gripper_setup.posture_checks import HandPostures, depth_at
from qdgrasp_assets.grippers.hand_model import read_hand_model
from qdgrasp_assets.grippers.urdf import read_urdf


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
    assert "face to face, clear of the palm" in found.draft.reasons["joints.thumb_turn"]
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
    assert not [note for note in found.found.notes if "through each other" in note]


def test_joints_are_told_not_to_close(guess):
    found = guess(synthetic_hands.claw(), not_closing=("right",))
    assert found.closing == {"left"}
    assert found.draft.reasons["joints.right"] == "does not close, as told"
    (warning,) = (words for words in found.warnings if "nothing closes the finger" in words)
    assert "'right_finger'" in warning
    assert "--finger LINK" in warning
