"""Journals that keep successes alone: pruned runs and merged ones."""

import errno
import importlib
import itertools
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_coordinator.storage.engine_table import read_table, table_path, write_table
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_protocol.errors import DiskFull, FolderError, InputError
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_tools.campaign import merge_prune
from qdgrasp_tools.campaign.merge_prune import merge_runs, prune_campaign, prune_run
from qdgrasp_tools.campaign.ranking import read_run_grasps
from qdgrasp_tools.campaign.reduced_journal import is_kept, reshape_rows
from qdgrasp_tools.campaign.summary import RunSummary, run_summary
from qdgrasp_tools.report.reference_builder import reference_set_of

N = 2400
"""Evaluations of each run; all of them are finished."""


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., RunFolder]:
    """Records rows as a run of one scene, by its name, in which every genome counts."""
    usual = {"evaluations": N, "overlaps": "count"}
    return lambda name, rows, gripper="jaw", **settings: record(
        tmp_path / name, made_scene(gripper), rows, **usual | settings
    )


@pytest.fixture
def runs(recorded) -> list[RunFolder]:
    """Three finished runs of one scene, with different methods and seeds."""
    settings = ({"seed": 0}, {"seed": 1}, {"seed": 0, "method": "contact_rand"})
    return [recorded(f"run-{n}", random_rows(N, seed=n), **one) for n, one in enumerate(settings)]


def rows_of(folder: RunFolder) -> Rows:
    with folder.journal() as journal:
        return np.concatenate([journal.shape.empty(0), *journal.kept()])


def digest_of(folder: RunFolder) -> str:
    with folder.journal() as journal:
        return journal_digest(journal)


def told(found: RunSummary) -> dict:
    """Figures that pruning leaves as they were."""
    values = msgspec.structs.asdict(found)
    return {name: value for name, value in values.items() if name != "reduced"}


def test_a_pruned_run_has_its_successes_and_all_its_figures_and_takes_less_room(runs) -> None:
    run, *_ = runs
    before, whole = run_summary(run), rows_of(run)
    size = (run.path / "run.sqlite").stat().st_size
    assert prune_run(run) == size - (run.path / "run.sqlite").stat().st_size > 0
    assert rows_of(run).tobytes() == successes(whole).tobytes()
    with run.journal() as journal:
        assert journal.successes().tobytes() == successes(whole).tobytes()
    after = run_summary(run)
    assert told(after) == told(before)
    assert after.reduced == "failures: only successes are kept"
    assert sorted(path.name for path in run.path.glob("run.sqlite*")) == ["run.sqlite"]


def judge(run: RunFolder) -> Rows:
    """Write a table of MuJoCo's verdicts on every other success; returns these, by their numbers."""
    rows = rows_of(run)
    numbers = np.flatnonzero((rows["outcome"] >= Outcome.DROPPED) & (rows["trial"] == 0))[::2]
    write_table(run, "mujoco", numbers, rows[numbers], rows[numbers])
    return rows[numbers]


def test_a_table_of_another_engine_gets_the_new_numbers_of_its_rows(runs) -> None:
    run, *_ = runs
    judged = judge(run)
    prune_run(run)
    table = read_table(table_path(run, "mujoco"))
    assert rows_of(run)[table["row"]].tobytes() == judged.tobytes()
    assert table["outcome_now"].tolist() == judged["outcome"].tolist()
    assert not list(run.path.glob("*.part"))


@pytest.mark.parametrize(("end", "is_kept"), [("run.sqlite.part", True), ("engine-mujoco.csv.part", False)])
def test_an_interrupted_prune_leaves_no_table_with_numbers_of_other_rows(runs, monkeypatch, end, is_kept):
    run, *_ = runs
    judge(run)
    table, before, replace = table_path(run, "mujoco"), digest_of(run), Path.replace
    judged = table.read_bytes()

    def killed(path: Path, target: Path) -> Path:
        if path.name == end:
            raise KeyboardInterrupt
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        prune_run(run)
    assert [path.read_bytes() for path in run.path.glob("engine-*")] == [judged] * is_kept
    assert not is_kept or digest_of(run) == before


def test_a_full_disk_leaves_a_table_of_another_engine_as_it_was(runs, monkeypatch) -> None:
    run, *_ = runs
    judge(run)
    before, table = digest_of(run), table_path(run, "mujoco").read_bytes()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(merge_prune.atomic_files, "write_through", full)
    with pytest.raises(DiskFull):
        prune_run(run)
    assert (digest_of(run), table_path(run, "mujoco").read_bytes()) == (before, table)


def test_a_reduced_journal_says_on_what_its_rows_were_made(tmp_path, runs) -> None:
    here = {"pybullet": "3.2.7", "machine": "x86_64"}
    for run, machine in zip(runs, ("x86_64", "x86_64", "arm64"), strict=True):
        with JournalWriter.open(run.path) as journal:
            journal.set_platform(here | {"machine": machine})
    prune_run(runs[0])
    merge_runs(runs, tmp_path / "all")
    with runs[0].journal() as pruned, RunFolder(tmp_path / "all").journal() as merged:
        assert (pruned.platform, merged.platform) == (here, {"pybullet": "3.2.7"})


def test_what_needs_every_row_is_refused_with_the_digest_that_the_run_had(runs) -> None:
    run, *_ = runs
    before = digest_of(run)
    prune_run(run)
    acts = (lambda: digest_of(run), lambda: prune_run(run), lambda: JournalWriter.open(run.path))
    for act in acts:
        with pytest.raises(FolderError, match=f"keeps the successes alone of .*whose digest was {before};"):
            act()


def test_a_run_that_is_not_finished_or_in_use_is_not_pruned(recorded) -> None:
    run = recorded("run", random_rows(20))
    before = digest_of(run)
    with pytest.raises(FolderError, match="is not finished"):
        prune_run(run)
    with run.job.lock(), pytest.raises(FolderError, match="in use"):
        prune_run(run)
    assert digest_of(run) == before


def test_a_run_that_is_being_read_is_left_as_it_was(runs, monkeypatch) -> None:
    run, *_ = runs
    before = digest_of(run)
    monkeypatch.setattr(merge_prune, "SETTLE_TIMEOUT", 0.0)
    with run.journal() as reader:
        with pytest.raises(FolderError, match=r"run\.sqlite is being read by another process; nothing was"):
            prune_run(run)
        assert reader.count == N
    assert digest_of(run) == before
    assert not list(run.path.glob("*.part"))


def test_a_run_that_is_read_for_a_moment_is_pruned_after_it(runs, monkeypatch) -> None:
    run, *_ = runs
    reader = run.journal()
    monkeypatch.setattr(merge_prune.time, "sleep", lambda _: reader.close())
    assert prune_run(run) > 0


def test_a_full_disk_leaves_the_run_as_it_was(runs, monkeypatch) -> None:
    run, *_ = runs
    before = digest_of(run)

    def full(*_: object, **__: object) -> None:
        error = sqlite3.OperationalError("database or disk is full")
        error.sqlite_errorcode = sqlite3.SQLITE_FULL
        raise error

    monkeypatch.setattr("qdgrasp_tools.campaign.reduced_journal.insert_rows", full)
    with pytest.raises(DiskFull):
        prune_run(run)
    assert digest_of(run) == before
    assert not list(run.path.glob("*.part"))


def test_of_a_campaign_the_finished_runs_are_pruned(tmp_path, recorded) -> None:
    home = JobFolder.create(tmp_path / "many", "many").path
    for number, budget in enumerate((N, 2 * N)):
        recorded("made", random_rows(N), evaluations=budget).path.rename(home / "runs" / f"run-{number}")
    done = prune_campaign(JobFolder(home))
    assert (done.pruned, done.runs) == (1, 2)
    assert done.freed > 0
    assert prune_campaign(JobFolder(home)).pruned == 1
    assert run_summary(RunFolder(home / "runs" / "run-0")).reduced
    assert not run_summary(RunFolder(home / "runs" / "run-1")).reduced


def test_merged_runs_hold_the_successes_of_all_and_say_whose_they_are(tmp_path, runs) -> None:
    found = merge_runs(runs, tmp_path / "all").summary
    folder = RunFolder.open(tmp_path / "all")
    parts = [successes(rows_of(run)) for run in runs]
    assert rows_of(folder).tobytes() == b"".join(part.tobytes() for part in parts)
    with folder.journal() as journal:
        assert [source.run for source in journal.sources] == ["run-0", "run-1", "run-2"]
        assert [source.kept for source in journal.sources] == list(map(len, parts))
        assert [source.digest for source in journal.sources] == [digest_of(run) for run in runs]
        assert [source.asked for source in journal.sources] == [run.spec for run in runs]
    assert msgspec.structs.replace(run_summary(folder)) == found
    assert found.method == "aimed, contact_rand"
    assert found.evaluations == 3 * N
    cells = {tuple(cell) for part in parts for cell in np.rint(100 * part["descriptor"].astype(float))}
    assert found.cells == len(cells)
    assert found.robust == sum(np.count_nonzero(part["outcome"] == Outcome.HELD) for part in parts)
    assert len(reference_set_of(folder).cells) == len(cells)


def test_counts_of_second_answers_are_summed_and_shares_of_a_table_are_not_taken_over(tmp_path, runs) -> None:
    for run, (checked, differing) in zip(runs, ((5, 1), (7, 0), (0, 0)), strict=True):
        judge(run)
        with closing(sqlite3.connect(run.path / "run.sqlite")) as journal, journal:
            counts = (("checked", checked), ("differing", differing))
            journal.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", counts)
    found = merge_runs(runs, tmp_path / "all").summary
    assert (found.checked, found.differing, found.in_both) == (12, 1, {})


def test_the_order_in_which_runs_are_named_does_not_matter_nor_whether_they_were_pruned_or_merged(
    tmp_path, runs
) -> None:
    expected = merge_runs(runs, tmp_path / "all").summary
    content = rows_of(RunFolder(tmp_path / "all")).tobytes()
    for number, order in enumerate(itertools.permutations(runs)):
        assert merge_runs(order, tmp_path / f"all-{number}").summary == expected
        assert rows_of(RunFolder(tmp_path / f"all-{number}")).tobytes() == content
    merge_runs(runs[1:], tmp_path / "two")
    prune_run(runs[0])
    again = merge_runs([RunFolder(tmp_path / "two"), runs[0], runs[1], runs[0]], tmp_path / "again").summary
    assert again == expected
    assert rows_of(RunFolder(tmp_path / "again")).tobytes() == content


@pytest.mark.parametrize("rows", [0, 17, N - 1])
def test_a_run_beside_its_own_beginning_counts_once_and_that_is_said(tmp_path, recorded, runs, rows) -> None:
    early = recorded("early", random_rows(N, seed=0)[:rows], seed=0)
    alone = merge_runs(runs, tmp_path / "all")
    assert alone.repeats == ()
    for number, order in enumerate(itertools.permutations([early, *runs[:2]])):
        found = merge_runs([*order, runs[2]], tmp_path / f"all-{number}")
        assert found.summary == alone.summary
        assert found.repeats == (
            f"{early.path} records a part of the search that {runs[0].path} records: it counts once.",
        )


def test_a_search_counts_once_whatever_ended_it_and_whatever_was_pruned_or_merged(tmp_path, recorded, runs):
    whole, rows = runs[0], random_rows(N, seed=0)
    sooner = recorded("sooner", rows[:100], evaluations=100, seed=0)
    early = recorded("early", rows[:150], seed=0)
    prune_run(sooner)
    merge_runs([early, runs[1]], tmp_path / "two")
    found = merge_runs([RunFolder(tmp_path / "two"), sooner, whole], tmp_path / "all")
    assert found.summary == merge_runs(runs[:2], tmp_path / "expected").summary
    said = f" records a part of the search that {whole.path} records: it counts once."
    assert sorted(found.repeats) == sorted([f"'early' in {tmp_path / 'two'}{said}", f"{sooner.path}{said}"])


def test_records_of_one_search_that_disagree_count_each(tmp_path, recorded, runs) -> None:
    rows = random_rows(N, seed=0)
    rows["nu"][rows["outcome"] == Outcome.HELD] += 1e-6  # another machine
    found = merge_runs([runs[0], recorded("other", rows[:100], seed=0)], tmp_path / "all")
    assert found.repeats == ()
    assert found.summary.evaluations == N + 100


def test_rows_of_priors_with_fewer_genes_are_filled_with_zeros(tmp_path, recorded, runs) -> None:
    wide = reshape_rows(random_rows(N), RowShape(genes=5, joints=2, descriptors=3))
    wide["genome"] = 0.5
    merge_runs([runs[2], recorded("wide", wide[is_kept(wide)], seed=9)], tmp_path / "all")
    rows = rows_of(RunFolder(tmp_path / "all"))
    narrow = successes(rows_of(runs[2]))
    assert rows["genome"].shape[1] == 5
    assert rows["genome"][-len(narrow) :, 2:].max() == 0
    assert np.array_equal(rows["base_to_object"][-len(narrow) :], narrow["base_to_object"])


def test_runs_of_different_scenes_are_refused_and_what_differs_is_named(tmp_path, recorded, runs) -> None:
    heavy = recorded("heavy", random_rows(N), "other", mass=2.5)
    with pytest.raises(
        InputError, match=r"different scenes.*differ in mass \((0\.1 and 2\.5|2\.5 and 0\.1)\)"
    ):
        merge_runs([runs[0], heavy], tmp_path / "all")
    same = recorded("same", random_rows(N), "other")
    with pytest.raises(InputError, match="the scene's files or the version of qdgrasp"):
        merge_runs([runs[0], same], tmp_path / "all")
    assert not (tmp_path / "all").exists()


def test_a_merge_that_fails_leaves_nothing(tmp_path, runs) -> None:
    with closing(sqlite3.connect(runs[2].path / "run.sqlite")) as journal, journal:
        journal.execute("UPDATE blocks SET crc = crc + 1")
    with pytest.raises(FolderError, match="are not what was recorded"):
        merge_runs(runs, tmp_path / "all")
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(FolderError, match="holds a run already"):
        merge_runs(runs[:2], runs[0].path)
    assert sorted(path.name for path in tmp_path.iterdir()) == before == ["run-0", "run-1", "run-2"]


def test_unfinished_runs_are_merged_unless_successes_lack_trials(tmp_path, recorded, runs) -> None:
    half = recorded("half", random_rows(40, seed=7), seed=7)
    assert not merge_runs([runs[0], half], tmp_path / "all").summary.complete
    robust = recorded("robust", random_rows(40), protocol="robust")
    with pytest.raises(InputError, match="lack their trials"):
        merge_runs([robust], tmp_path / "none")


def test_grasps_of_runs_with_different_priors_are_not_ranked_together(tmp_path, runs) -> None:
    merge_runs(runs[:2], tmp_path / "aimed")
    assert len(read_run_grasps(RunFolder(tmp_path / "aimed"))) == sum(
        len(read_run_grasps(run)) for run in runs[:2]
    )
    merge_runs(runs, tmp_path / "all")
    with pytest.raises(InputError, match="different priors, aimed and contact"):
        read_run_grasps(RunFolder(tmp_path / "all"))


@pytest.mark.parametrize("moment", ["run_summary", "source_rows"])
def test_a_run_that_grows_while_it_is_merged_is_refused(tmp_path, recorded, runs, monkeypatch, moment):
    rows = random_rows(60, seed=7)
    rows["outcome"] = Outcome.HELD
    growing = recorded("growing", rows[:40], seed=7)
    module = {"run_summary": "reduced_journal", "source_rows": "merge_prune"}[moment]
    read = getattr(importlib.import_module(f"qdgrasp_tools.campaign.{module}"), moment)

    def grown(folder: RunFolder, *rest: int) -> object:
        with growing.journal() as journal:
            known = journal.count
        if folder is growing and known == 40:
            with JournalWriter.open(growing.path) as journal:
                journal.append(JournalSlice(40, rows[40:]), 1, 2.0)
        return read(folder, *rest)

    monkeypatch.setattr(f"qdgrasp_tools.campaign.{module}.{moment}", grown)
    with pytest.raises(FolderError, match="'growing' grew while it was read; wait until it is done"):
        merge_runs([growing, runs[0]], tmp_path / "all")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["growing", "run-0", "run-1", "run-2"]
    assert merge_runs([growing, runs[0]], tmp_path / "all").summary.rows == 60 + N
