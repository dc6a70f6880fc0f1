"""The table of what is guessed of public hands, on a synthetic one."""

from pathlib import Path

import pytest
from benchmarks import hand_guesses
from benchmarks.hand_guesses import KnownHand, guessed
from tests.assets import synthetic_hands

CLAW = KnownHand("claw.urdf", "boxes", "palm", (0, 0, 1), 2)


@pytest.fixture
def claw(tmp_path: Path) -> Path:
    (tmp_path / "claw.urdf").write_text(synthetic_hands.claw())
    return tmp_path / "claw.urdf"


def test_a_right_guess_is_told_as_it_is(claw: Path) -> None:
    assert guessed(CLAW, claw).row() == ["none", "palm", "0, 0, 1", "2", "2 joints", "none"]


@pytest.mark.parametrize(
    ("known", "column"),
    [
        (KnownHand("claw.urdf", "boxes", "wrist", (0, 0, 1), 2), 1),
        (KnownHand("claw.urdf", "boxes", "palm", (0, 1, 0), 2), 2),
        (KnownHand("claw.urdf", "boxes", "palm", (0, 0, 1), 3), 3),
        (KnownHand("claw.urdf", "boxes", "palm", (0, 0, 1), 2, still="left"), 4),
        (KnownHand("claw.urdf", "boxes", "palm", (0, 0, 1), 2, backward="left"), 4),
    ],
)
def test_a_guess_that_is_not_right_is_marked(claw: Path, known: KnownHand, column: int) -> None:
    row = guessed(known, claw).row()
    assert [place for place, words in enumerate(row) if words.startswith("WRONG")] == [column]


def test_a_hand_that_is_in_no_folder_is_named(
    claw: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hands = {"claw": CLAW, "other": KnownHand("other.urdf", "boxes", "palm", (0, 0, 1), 2)}
    monkeypatch.setattr(hand_guesses, "HANDS", hands)
    monkeypatch.setattr("sys.argv", ["hand_guesses", str(claw.parent), "--pictures", str(claw.parent)])
    assert hand_guesses.main() == 0
    shown = capsys.readouterr().out
    assert "not there" in shown
    assert "2 joints" in shown
    assert (claw.parent / "claw.png").is_file()
