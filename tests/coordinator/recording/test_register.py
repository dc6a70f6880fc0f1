"""The register reads journals that changed, and no others."""

import os
from pathlib import Path

import pytest
from tests.coordinator.recorded_runs import random_rows, record

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.recording import register
from qdgrasp_coordinator.recording.register import Register, rests


@pytest.fixture
def folder(tmp_path: Path, make_scene) -> RunFolder:
    """A run whose journal was written long ago."""
    made = record(tmp_path / "mug", make_scene(), random_rows(300))
    touch(made, 1e9)
    return made


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders whose journals were opened."""
    seen: list[Path] = []
    open_journal = Journal.open

    def noting(path: Path) -> Journal:
        seen.append(path)
        return open_journal(path)

    monkeypatch.setattr(Journal, "open", noting)
    return seen


def touch(folder: RunFolder, at: float) -> None:
    for file in folder.path.glob("run.sqlite*"):
        os.utime(file, (at, at))


def test_a_journal_that_rests_is_opened_once_for_all_answers(folder: RunFolder, opened: list[Path]) -> None:
    counted = Register(folder.path)
    told = [counted.page(0) for _ in range(5)]
    assert told == told[:1] * 5
    assert told[0].runs[0].rows == 300
    assert len(opened) == 1


def test_a_journal_that_changed_is_opened_again(folder: RunFolder, opened: list[Path]) -> None:
    counted = Register(folder.path)
    counted.page(0)
    touch(folder, 1e9 + 1)
    counted.page(0)
    assert len(opened) == 2


def test_a_journal_that_changed_a_moment_ago_may_change_unseen(folder: RunFolder, opened: list[Path]) -> None:
    counted = Register(folder.path)
    touch(folder, 4e9)
    for _ in range(3):
        counted.page(0)
    assert len(opened) == 3
    assert rests(((1, 1, 10**9),), 3.1)
    assert not rests(((1, 1, 10**9),), 2.9)


def test_what_is_counted_in_part_is_counted_on(
    folder: RunFolder, opened: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(register, "ROWS", 100)
    counted = Register(folder.path)
    assert [counted.page(0).uncounted for _ in range(5)] == [1, 1, 0, 0, 0]
    assert len(opened) == 3
