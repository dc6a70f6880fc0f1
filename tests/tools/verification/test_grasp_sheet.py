"""Grasps of a run that are drawn beside each other: which ones, and with which words."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene
from tests.tools.export.conftest import random_rows

from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.grasp_reader import read_run, select_grasps
from qdgrasp_tools.report.row_report import NoSuchRow
from qdgrasp_tools.verification.grasp_sheet import (
    FAILURE_COLOUR,
    MOST_PANELS,
    SheetChoice,
    grasp_labels,
    placed_hands,
    write_sheet,
)
from qdgrasp_tools.verification.replay_client import NoPose, PictureSize

GRASPED = [Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD]
OUTCOMES = [*GRASPED * 10, Outcome.OVERLAP, Outcome.MISSED, Outcome.DEAD_END]
PANEL = PictureSize(160, 120)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """Thirty successes, then an overlap, a miss, and a dead end without a pose."""
    rows = random_rows(made_scene(), OUTCOMES)
    rows["base_to_object"][-1] = 0
    return record(tmp_path / "run", made_scene(), rows, method="contact_rand")


@pytest.mark.parametrize(("words", "flag"), [("best:5", "top"), ("diverse:5", "diverse")])
def test_the_best_and_diverse_ones_are_those_of_the_python_api(run: RunFolder, words: str, flag: str) -> None:
    expected = select_grasps(read_run(run), **{flag: 5})
    assert SheetChoice.parse(words).read(run).numbers.tolist() == expected.numbers.tolist()


def test_random_ones_are_grasps_and_the_same_every_time(run: RunFolder) -> None:
    choice = SheetChoice.parse("random:7")
    drawn = choice.read(run)
    assert len(drawn) == len(set(drawn.numbers.tolist())) == 7
    assert drawn.is_grasp.all()
    assert drawn.numbers.tolist() == choice.read(run).numbers.tolist()
    assert drawn.numbers.tolist() != SheetChoice.parse("best:7").read(run).numbers.tolist()


def test_of_fewer_grasps_all_are_chosen(run: RunFolder) -> None:
    for rank in ("best", "diverse", "random"):
        numbers = SheetChoice.parse(f"{rank}:40").read(run).numbers
        assert sorted(numbers.tolist()) == [n for n in range(30) if OUTCOMES[n] >= Outcome.SHAKEN]


def test_rows_are_chosen_by_their_numbers_in_this_order_failures_too(run: RunFolder) -> None:
    chosen = SheetChoice.parse("31,2,30,2").read(run)
    assert chosen.numbers.tolist() == [31, 2, 30]
    assert [title for title, *_ in grasp_labels(chosen)] == ["31  missed", "2  held", "30  overlap"]
    assert [label.colour == FAILURE_COLOUR for label in grasp_labels(chosen)] == [True, False, True]


def test_a_label_says_fitness_or_eta_and_margin_where_they_are_known(run: RunFolder) -> None:
    chosen = SheetChoice.parse("1,2").read(run)
    chosen.eta[1] = 0.875
    chosen.__dict__["margin"] = np.array([0.0123, np.nan])
    assert [label.line for label in grasp_labels(chosen)] == ["fitness 1 of 2, margin 0.012", "eta 0.88"]


@pytest.mark.parametrize(
    "words", ["", "best", "best:0", "best:-1", "top:3", "best:3,4", "1,", "1;2", "diverse: 3"]
)
def test_other_words_are_refused(words: str) -> None:
    with pytest.raises(ImpossibleValue, match="--grasps must be best:N, diverse:N, random:N, or numbers"):
        SheetChoice.parse(words)


def test_too_many_and_a_row_that_is_not_there_or_has_no_pose_are_refused(run: RunFolder) -> None:
    for words in (f"best:{MOST_PANELS + 1}", ",".join(map(str, range(MOST_PANELS + 1)))):
        with pytest.raises(ImpossibleValue, match=f"at most {MOST_PANELS} grasps"):
            SheetChoice.parse(words)
    with pytest.raises(NoSuchRow):
        SheetChoice.parse("2,33").read(run)
    with pytest.raises(NoPose):
        SheetChoice.parse("2,32").read(run)


def test_a_run_without_a_grasp_is_refused_and_weak_ones_are_drawn_where_none_holds(tmp_path: Path) -> None:
    rows = random_rows(made_scene(), [Outcome.DROPPED, Outcome.MISSED])
    folder = record(tmp_path / "none", made_scene(), rows, method="contact_rand")
    choice = SheetChoice.parse("best:3")
    with pytest.raises(InputError, match="has no grasp yet"):
        choice.read(folder)
    assert SheetChoice.parse("0,1").read(folder).numbers.tolist() == [0, 1]
    rows["outcome"], rows["fitness"] = Outcome.SHAKEN, 1
    weak = record(tmp_path / "weak", made_scene(), rows, method="contact_rand", protocol="physical")
    assert choice.title(choice.read(weak)).endswith("2 grasps, the best first; no grasp survived every push")


def test_hands_stand_as_they_settled_or_open_as_commanded(run: RunFolder) -> None:
    chosen = SheetChoice.parse("2,30").read(run)
    closed, opened = placed_hands(chosen), placed_hands(chosen, pregrasp=True)
    np.testing.assert_array_equal(closed.poses, chosen.settled_poses("com"))
    np.testing.assert_array_equal(closed.joints, [chosen.joints[0], chosen.pregrasp[1]])
    np.testing.assert_array_equal(opened.poses, chosen.poses("com"))
    np.testing.assert_array_equal(opened.joints, chosen.pregrasp)


def test_a_sheet_is_the_same_file_every_time_and_nothing_after_a_signal(run, tmp_path) -> None:
    choice, stop = SheetChoice.parse("best:3"), Stop()
    chosen = choice.read(run)
    for name in ("one.png", "other.png"):
        write_sheet(chosen, choice.title(chosen), PANEL, OutFile(tmp_path / name), stop)
    one, other = ((tmp_path / name).read_bytes() for name in ("one.png", "other.png"))
    assert one == other
    with Image.open(tmp_path / "one.png") as image:
        assert image.width > 2 * PANEL.width
    stop.set(15)
    write_sheet(chosen, "", PANEL, OutFile(tmp_path / "stopped.png"), stop)
    assert not (tmp_path / "stopped.png").exists()


def test_a_title_names_hand_object_and_choice(run: RunFolder) -> None:
    titles = {}
    for words in ("best:2", "diverse:2", "random:2", "1", "30,1"):
        choice = SheetChoice.parse(words)
        titles[words] = choice.title(choice.read(run))
    assert titles == {
        "best:2": "jaw on block: 2 grasps, the best first",
        "diverse:2": "jaw on block: 2 grasps, well spread",
        "random:2": "jaw on block: 2 grasps, drawn at random",
        "1": "jaw on block: 1 grasp",
        "30,1": "jaw on block: 2 rows",
    }
