"""The register reads journals that changed, and no others."""

import os
from pathlib import Path

import pytest
from tests.coordinator.recorded_runs import random_rows, record

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
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
def campaign(tmp_path: Path, make_scene) -> Path:
    """The folder of a job with two runs: one that is over, and one that is not."""
    job = JobFolder.create(tmp_path / "job", "mugs")
    for name, budget in {"a": 300, "b": 1000}.items():
        alone = record(tmp_path / name, make_scene(), random_rows(300), evaluations=budget)
        alone.path.rename(job.run_path(name))
        (job.run_path(name) / "job.json").unlink()
    return job.path


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


def test_one_run_is_told_of_without_a_look_at_the_others(campaign: Path, opened: list[Path]) -> None:
    told = Register(campaign).one("b")
    assert ([one.budget for one in told.runs], told.next) == ([1000], 0)
    assert opened == [campaign / "runs" / "b"]


def test_of_a_run_that_is_not_there_nothing_is_told(campaign: Path) -> None:
    told = Register(campaign).one("c")
    assert (told.runs, told.uncounted, told.curve) == ([], 0, None)


@pytest.mark.parametrize("run", ["a", "b"])
def test_how_a_run_grew_is_known_as_far_as_it_is_counted_and_when_it_is_over(
    campaign: Path, run: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(register, "ROWS", 120)
    counted = Register(campaign)
    ends = []
    for _ in range(4):
        curve = counted.one(run).curve
        assert curve is not None
        ends.append([point.evaluations for point in curve.points])
    assert ends == [list(range(10, stop + 1, 10)) for stop in (120, 240, 300, 300)]
