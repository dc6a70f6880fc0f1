"""Finished runs whose journals need not be read again."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import SceneMaker

from qdgrasp_coordinator.campaigns import campaign_runs, finding
from qdgrasp_coordinator.campaigns.campaign_runs import finished
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.keeping.pruning import prune
from qdgrasp_protocol.errors import EndsTooSoon, FolderError

N = 100


@pytest.fixture
def run(tmp_path: Path, make_scene: SceneMaker) -> RunFolder:
    return record(tmp_path / "run", make_scene(), random_rows(N), evaluations=N, overlaps="count")


def no_reading(*_: object) -> None:
    raise AssertionError("its journal was read")


def test_a_finished_run_is_read_once(run: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    first = finished(run.path, run.spec)
    assert first is not None
    assert first.evaluations == N
    monkeypatch.setattr(campaign_runs, "tally_within", no_reading)
    assert finished(run.path, run.spec) == first


def test_another_end_or_other_rows_are_counted_anew(run: RunFolder) -> None:
    known = finished(run.path, run.spec)
    assert finding.read(run, run.spec) == known
    longer = msgspec.structs.replace(run.spec, evaluations=N + 1)
    assert finding.read(run, longer) is None
    assert finished(run.path, longer) is None
    with closing(sqlite3.connect(run.path / "run.sqlite")) as journal, journal:
        journal.execute("UPDATE blocks SET crc = crc + 1")
    assert finding.read(run, run.spec) is None


@pytest.mark.parametrize("content", ["", "{}", '{"mark": 1}'])
def test_what_cannot_be_read_is_counted_anew(run: RunFolder, content: str) -> None:
    known = finished(run.path, run.spec)
    (run.path / finding.FILE).write_text(content)
    assert finished(run.path, run.spec) == known


def test_an_unfinished_run_leaves_nothing(tmp_path: Path, make_scene: SceneMaker) -> None:
    run = record(tmp_path / "half", make_scene(), random_rows(N), evaluations=N + 1, overlaps="count")
    assert finished(run.path, run.spec) is None
    assert not (run.path / finding.FILE).exists()


def test_a_pruned_run_is_finished_with_what_it_had_and_cannot_be_extended(run: RunFolder) -> None:
    known = finished(run.path, run.spec)
    prune(run)
    assert finished(run.path, run.spec) == known
    with pytest.raises(FolderError, match="was pruned"):
        finished(run.path, msgspec.structs.replace(run.spec, evaluations=N + 1))


def test_a_run_that_is_to_end_before_what_is_recorded_is_named(run: RunFolder) -> None:
    said = (
        f"{re.escape(str(run.path))} cannot end as is asked: evaluations must be at least {N}, .* got {N - 1}"
    )
    with pytest.raises(EndsTooSoon, match=said):
        finished(run.path, msgspec.structs.replace(run.spec, evaluations=N - 1))
