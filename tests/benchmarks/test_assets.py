"""Benchmarks on meshes and hands: the generated library, and guesses for public hands."""

import csv
from pathlib import Path

import pytest
from benchmarks import hand_guesses
from benchmarks.hand_guesses import KnownHand, guessed
from benchmarks.object_library.generator import KINDS, make_library
from tests.assets import synthetic_hands

from qdgrasp_tools.campaign.object_library import LibraryRules, read_library

CLAW = KnownHand("claw.urdf", "boxes", "palm", (0, 0, 1), 2)


def broken(out: Path) -> list[str]:
    with (out / "broken.csv").open(newline="") as file:
        return [row["id"] for row in csv.DictReader(file)]


def test_what_is_broken_on_purpose_and_nothing_else_cannot_be_used(tmp_path, monkeypatch):
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    found = read_library(make_library(tmp_path / "out", 100, 0), LibraryRules(skip_unusable=True))
    assert [each.object for each in found.skipped] == broken(tmp_path / "out")
    assert len(found.skipped) == 2
    assert {values["about"]["category"] for values in found.objects.values()} == set(KINDS)


def test_a_larger_library_begins_with_the_smaller_one(tmp_path):
    make_library(tmp_path / "one", 7, 3)
    make_library(tmp_path / "other", 9, 3)
    make_library(tmp_path / "third", 7, 4)
    files = {file.name: file.read_bytes() for file in (tmp_path / "one" / "meshes").iterdir()}
    again = {name: (tmp_path / "other" / "meshes" / name).read_bytes() for name in files}
    assert files == again
    assert files != {name: (tmp_path / "third" / "meshes" / name).read_bytes() for name in files}


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


def test_a_hand_that_is_in_no_folder_is_named(claw, monkeypatch, capsys) -> None:
    hands = {"claw": CLAW, "other": KnownHand("other.urdf", "boxes", "palm", (0, 0, 1), 2)}
    monkeypatch.setattr(hand_guesses, "HANDS", hands)
    monkeypatch.setattr("sys.argv", ["hand_guesses", str(claw.parent), "--pictures", str(claw.parent)])
    assert hand_guesses.main() == 0
    shown = capsys.readouterr().out
    assert "not there" in shown
    assert "2 joints" in shown
    assert (claw.parent / "claw.png").is_file()
