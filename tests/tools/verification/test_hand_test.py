"""The test that ends `gripper new`: kinds of right and wrong hands, evaluated in this process."""

import xml.etree.ElementTree as ET
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.assets import synthetic_hands
from tests.assets.example_hands import JAW_URDF, LINKAGE_URDF

from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.gripper_setup.repaired_copy import centre_base
from qdgrasp_assets.grippers.gripper import read_gripper
from qdgrasp_assets.grippers.hand_model import guess_base
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_assets.scene import unpack_scene
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import RunQueue
from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_protocol.process import Stop
from qdgrasp_tools.verification import hand_test
from qdgrasp_worker.evaluator import Evaluator


def evaluate_here(_job: str, queue: RunQueue, make_record: Any, *_: object) -> None:
    """Carry out a queue of runs in this process."""
    while (plan := queue.next()) is not None:
        generation, sink = plan.pipeline.ask(), make_record(plan)
        assert isinstance(sink, RowSink)
        assert generation is not None
        with Evaluator(unpack_scene(plan.bundle.payload)) as evaluator:
            found = evaluator.evaluate(plan.prior, generation.genomes, generation.trials)
        sink.push(JournalSlice(0, found.rows))


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """What the test says of the hand that is guessed for a URDF, and the flags that it proposes."""
    monkeypatch.setattr(hand_test, "run_temporary_job", evaluate_here)
    monkeypatch.setattr(hand_test, "progress_display", lambda *_: nullcontext())

    def of(urdf: str, *, centred: bool = False, **told: Any) -> tuple[str, list[str]]:
        (tmp_path / "hand.urdf").write_text(urdf)
        robot, given = read_urdf(tmp_path / "hand.urdf"), DraftOverrides(**told)
        if copy := centre_base(robot, guess_base(robot)[0], given) if centred else None:
            robot, given = copy.robot, replace(given, base_link=copy.base)
            (tmp_path / "hand.urdf").write_bytes(ET.tostring(robot.element))
        made = draft_gripper(robot, "hand.urdf", given)
        (tmp_path / "hand.toml").write_text(draft_toml(made, "hand.toml"))
        hand = read_gripper(tmp_path / "hand.toml", "hand", "hand.toml")
        found = hand_test.try_hand(hand, tmp_path / "hand.toml", made.closing, Stop())
        assert found is not None
        return found.fault, list(found.flags())

    return of


@pytest.mark.parametrize(
    "urdf", [JAW_URDF, LINKAGE_URDF, synthetic_hands.claw(mimics=True), synthetic_hands.THUMB_HAND]
)
def test_a_right_hand_holds_and_all_of_its_fingers_touch(tried: Any, urdf: str) -> None:
    assert tried(urdf, centred=True)[0] == ""


ASIDE = JAW_URDF.replace('xyz="0 -0.045 0.041"', 'xyz="0.08 -0.045 0.041"')
LIFTED = JAW_URDF.replace('axis xyz="0 -1 0"', 'axis xyz="0 0 1"')


@pytest.mark.parametrize(
    ("urdf", "told", "flag"),
    [
        (ASIDE, {}, "--repair"),
        (LIFTED, {}, "--open slide=-0.04 --closed slide=0"),
        (JAW_URDF, {"closed": {"slide": -0.004}}, "--open slide=0 --closed slide=-0.04"),
        (synthetic_hands.THUMB_HAND, {"approach_axis": (0.0, 0.0, 1.0)}, "--approach-axis 0 1 0"),
    ],
)
def test_a_wrong_hand_is_found_with_the_flag_that_may_correct_it(
    tried: Any, urdf: str, told: dict[str, Any], flag: str
) -> None:
    fault, flags = tried(urdf, **told)
    assert fault
    assert any(each.startswith(flag) for each in flags[:3]), flags
