import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.common import PATIENCE
from tests.coordinator.recorded_runs import spoil_block

from qdgrasp_coordinator.storage import journal as journal_module
from qdgrasp_coordinator.storage.journal import (
    Journal,
    JournalIdentity,
    JournalSlice,
    join_slices,
    slice_from_message,
    slice_to_message,
)
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.outputs import JOURNAL
from qdgrasp_coordinator.storage.run_folder import journal_digest
from qdgrasp_protocol.errors import DiskFull, FolderError
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

SHAPE = RowShape(genes=7, joints=2, contact_slots=2)
SPEC = RunSpec(gripper="panda", object="mug", evaluations=100)
IDENTITY = JournalIdentity("run", SPEC, "ab" * 32, SHAPE)


def make_rows(n: int, seed: int = 0) -> Rows:
    """Rows of all outcomes, in journal order."""
    random = np.random.default_rng(seed)
    rows = np.frombuffer(random.integers(0, 64, n * SHAPE.dtype.itemsize, np.uint8), SHAPE.dtype).copy()
    rows["generation"], rows["index"], rows["trial"] = np.arange(n) // 50, np.arange(n) % 50, 0
    rows["outcome"] = random.integers(Outcome.DEAD_END, Outcome.HELD, n, endpoint=True)
    rows["fitness"] = np.clip(rows["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    for name in ("descriptor", "base_to_object"):
        rows[name] = random.uniform(-0.3, 0.3, rows[name].shape)
    return rows


def record(folder: Path, rows: Rows, sizes: list[int]) -> None:
    """Record rows in blocks of these sizes."""
    with JournalWriter.create(folder, IDENTITY) as journal:
        journal.begin_epoch(1, 1000.0)
        first = 0
        for size in sizes:
            journal.append(
                JournalSlice(first, rows[first : first + size], cpu_seconds=size / 10), 1, 1000.0 + first
            )
            first += size


def test_what_is_recorded_is_read_again_byte_for_byte(tmp_path: Path) -> None:
    rows = make_rows(300)
    record(tmp_path, rows, [1, 99, 200])
    with Journal.open(tmp_path) as journal:
        assert np.concatenate(list(journal.blocks())).tobytes() == rows.tobytes()
        assert journal.count == 300
        assert (journal.run, journal.scene, journal.shape, journal.spec) == ("run", "ab" * 32, SHAPE, SPEC)
        assert journal.cpu_seconds == pytest.approx(30.0)


@given(first=st.integers(0, 130), limit=st.integers(0, 130))
def test_any_page_of_rows_is_that_slice_of_the_journal(tmp_path_factory, first, limit) -> None:
    folder = tmp_path_factory.getbasetemp() / "pages"
    rows = make_rows(120)
    if not folder.exists():
        folder.mkdir()
        record(folder, rows, [7, 1, 50, 62])
    with Journal.open(folder) as journal:
        assert journal.slice(first, limit).rows.tobytes() == rows[first : first + limit].tobytes()


def test_the_digest_is_of_rows_and_not_of_blocks_or_costs(tmp_path: Path) -> None:
    rows, digests = make_rows(200), set()
    for number, sizes in enumerate([[200], [1] * 200, [13, 87, 100]]):
        folder = tmp_path / str(number)
        folder.mkdir()
        record(folder, rows, sizes)
        with Journal.open(folder) as journal:
            digests.add(journal_digest(journal))
    assert len(digests) == 1
    assert all(len(text) == 64 for text in digests)


def test_rows_that_are_not_the_next_are_refused(tmp_path: Path) -> None:
    rows = make_rows(10)
    with JournalWriter.create(tmp_path, IDENTITY) as journal:
        with pytest.raises(FolderError, match="restore the folder from a copy"):
            journal.append(JournalSlice(5, rows), 1, 0.0)
        journal.append(JournalSlice(0, rows), 1, 0.0)
        with pytest.raises(ValueError, match="row 10 is next"):
            journal.append(JournalSlice(5, rows), 1, 0.0)
        assert journal.count == 10


def test_a_reader_sees_the_journal_as_it_was_when_it_was_opened(tmp_path: Path) -> None:
    rows = make_rows(20)
    with JournalWriter.create(tmp_path, IDENTITY) as writer:
        writer.append(JournalSlice(0, rows[:10]), 1, 0.0)
        with Journal.open(tmp_path) as early:
            writer.append(JournalSlice(10, rows[10:]), 1, 0.0)
            assert (early.count, len(early.slice(0, 100).rows)) == (10, 10)
        with Journal.open(tmp_path) as late:
            assert late.count == 20


@pytest.mark.parametrize("is_replaced", [False, True])
def test_rows_are_not_taken_for_durable_in_a_journal_that_was_deleted(tmp_path, is_replaced) -> None:
    rows = make_rows(20)
    with JournalWriter.create(tmp_path, IDENTITY) as journal:
        journal.append(JournalSlice(0, rows[:10]), 1, 0.0)
        file = tmp_path / "run.sqlite"
        copy = file.read_bytes()
        file.unlink()
        if is_replaced:
            file.write_bytes(copy)
        with pytest.raises(FolderError, match=r"run\.sqlite was deleted or replaced while its run was"):
            journal.append(JournalSlice(10, rows[10:]), 1, 0.0)


def test_rows_are_there_after_the_writer_was_killed(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from importlib import util\n"
        f"spec = util.spec_from_file_location('journal_tests', {__file__!r})\n"
        "tests = util.module_from_spec(spec); spec.loader.exec_module(tests)\n"
        f"writer = tests.JournalWriter.create(Path({str(tmp_path)!r}), tests.IDENTITY)\n"
        "writer.append(tests.JournalSlice(0, tests.make_rows(50)), 1, 0.0)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE)
    assert done.returncode == -signal.SIGKILL
    with Journal.open(tmp_path) as journal:
        assert journal.slice(0, 100).rows.tobytes() == make_rows(50).tobytes()
    with JournalWriter.open(tmp_path) as writer:
        writer.append(JournalSlice(50, make_rows(50)), 1, 0.0)
        assert writer.count == 100


def test_a_full_disk_takes_nothing_and_what_was_there_stays(tmp_path: Path) -> None:
    rows = make_rows(3000)
    with JournalWriter.create(tmp_path, IDENTITY) as journal:
        journal.append(JournalSlice(0, rows[:100]), 1, 0.0)
        pages = journal._database.execute("PRAGMA page_count").fetchone()[0]
        journal._database.execute(f"PRAGMA max_page_count = {pages + 5}")
        with pytest.raises(DiskFull, match="no room"):
            journal.append(JournalSlice(100, rows[100:]), 1, 0.0)
        assert journal.count == 100
        assert journal.slice(0, 5000).rows.tobytes() == rows[:100].tobytes()
        journal._database.execute("PRAGMA max_page_count = 100000")
        journal.append(JournalSlice(100, rows[100:]), 1, 0.0)
        assert journal.slice(0, 5000).rows.tobytes() == rows.tobytes()


def test_the_journal_of_a_run_that_has_not_begun_is_empty() -> None:
    with Journal.empty(IDENTITY) as journal:
        assert (journal.count, journal.cpu_seconds, journal.wall_seconds, journal.platform) == (0, 0, 0, {})
        assert list(journal.blocks()) == []
        assert journal.spec == SPEC


def check_refused(folder: Path, words: str) -> None:
    """Check that neither a reader nor a writer takes the journal in a folder."""
    for opener in (Journal.open, JournalWriter.open):
        with pytest.raises(FolderError, match=words):
            opener(folder)


def test_who_made_a_row_is_known_after_a_message_parts_and_commits(tmp_path: Path) -> None:
    rows, makers = make_rows(9), (*["a here"] * 4, *["b there"] * 3, *["a here"] * 2)
    whole = JournalSlice(0, rows, makers=makers)
    came = slice_from_message(slice_to_message(whole, "run", 1, SHAPE), SHAPE)
    parts = [came.part(0, 3), join_slices([came.part(3, 5), came.part(5, 9)])]
    with JournalWriter.create(tmp_path, IDENTITY) as journal:
        for part in parts:
            journal.append(part, 1, 0.0)
        assert journal.makers() == [
            (0, 3, "a", "here"),
            (3, 1, "a", "here"),
            (4, 3, "b", "there"),
            (7, 2, "a", "here"),
        ]
        assert journal.makers(5, 6) == [(4, 3, "b", "there")]


class TestRefusals:
    def test_another_programs_database_is_refused_and_not_touched(self, tmp_path: Path) -> None:
        with sqlite3.connect(tmp_path / JOURNAL) as database:
            database.execute("CREATE TABLE mine (a)")
        before = (tmp_path / JOURNAL).read_bytes()
        check_refused(tmp_path, "not a journal of qdgrasp")
        assert (tmp_path / JOURNAL).read_bytes() == before

    def test_a_torn_file_is_said_to_be_damaged(self, tmp_path: Path) -> None:
        record(tmp_path, make_rows(3000), [3000])
        size = (tmp_path / JOURNAL).stat().st_size
        os.truncate(tmp_path / JOURNAL, size // 2 // 4096 * 4096)
        with pytest.raises(FolderError, match="is damaged"), Journal.open(tmp_path) as journal:
            list(journal.blocks())

    def test_an_altered_row_is_said_to_be_damaged(self, tmp_path: Path) -> None:
        record(tmp_path, make_rows(100), [50, 50])
        spoil_block(tmp_path / JOURNAL, 0)
        with Journal.open(tmp_path) as journal:
            assert len(journal.slice(50, 50).rows) == 50
            with pytest.raises(FolderError, match="rows 0 to 49 are not what was recorded"):
                journal.slice(10, 1)

    def test_a_missing_block_is_said_to_be_damage(self, tmp_path: Path) -> None:
        record(tmp_path, make_rows(30), [10, 10, 10])
        with sqlite3.connect(tmp_path / JOURNAL) as database:
            database.execute("DELETE FROM blocks WHERE first = 10")
        with Journal.open(tmp_path) as journal, pytest.raises(FolderError, match="is damaged"):
            list(journal.blocks())


class ClosedPlace:
    """A connection to a database in a folder where no file beside it can be made."""

    def execute(self, _: str) -> None:
        error = sqlite3.OperationalError("unable to open database file")
        error.sqlite_errorcode = sqlite3.SQLITE_CANTOPEN
        raise error

    def close(self) -> None:
        """Nothing is open."""


def test_rows_that_cannot_be_read_in_a_closed_place_are_not_left_out(tmp_path, monkeypatch) -> None:
    connect = sqlite3.connect

    def in_closed_place(name: str, **how: Any) -> Any:
        return ClosedPlace() if name.endswith("mode=ro") else connect(name, **how)

    with JournalWriter.create(tmp_path, IDENTITY) as writer:
        writer.append(JournalSlice(0, make_rows(20)), 1, 0.0)
        with monkeypatch.context() as patch:
            patch.setattr(journal_module.sqlite3, "connect", in_closed_place)
            with pytest.raises(FolderError, match=r"has rows in run\.sqlite-wal: copy the folder"):
                Journal.open(tmp_path)
    monkeypatch.setattr(journal_module.sqlite3, "connect", in_closed_place)
    with Journal.open(tmp_path) as journal:
        assert journal.count == 20
