from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.fakes.messages import open_run
from tests.fakes.recorder import BUNDLE, JOB, SCENE, SHAPE, SPEC, anonymous, make_rows

from qdgrasp_coordinator.recorder.recorder import COMMITS_AT_ONCE, Recorder
from qdgrasp_coordinator.recorder.run_writer import GROUP_SECONDS
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal, JournalSlice, slice_to_message
from qdgrasp_coordinator.storage.journal_writer import OpenJournals
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.errors import FolderError, MessageError, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Open, Opened, Recordable
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_tools.campaign.campaign_folder import CampaignRunQueue

ROWS = make_rows(100)
HERE, ELSEWHERE = {"pybullet": "3.2.7"}, {"pybullet": "3.2.6"}


@contextmanager
def recording(path: Path, open_journals: int = 64) -> Iterator[Recorder]:
    with OpenJournals(open_journals) as journals, Recorder(path, JOB, 60.0, journals) as recorder:
        yield recorder


def ask(*runs: str, epoch: int = 0, spec: RunSpec = SPEC, scene: str = BUNDLE.digest) -> Open:
    opened = [open_run(run=run, spec=to_toml(spec).encode(), scene=scene) for run in runs]
    return Open(job=JOB, runs=opened, epoch=epoch)


def rows(run: str, first: int, stop: int, epoch: int = 1) -> Recordable:
    return slice_to_message(JournalSlice(first, ROWS[first:stop]), run, epoch, SHAPE)


def record(recorder: Recorder, run: str, stop: int, platform: dict[str, str]) -> None:
    part = JournalSlice(0, ROWS[:stop])
    recorder.add_rows(slice_to_message(part, run, recorder.epoch, SHAPE, platform), 0.0)
    recorder.commit(run)


def journalled(path: Path, run: str) -> bytes:
    with Journal.open(path / "runs" / run) as journal:
        return journal.slice(0, 1000).rows.tobytes()


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def content(folder: Path) -> dict[Path, bytes]:
    """The content of all files, without the shared memory of readers."""
    files = [file for file in folder.rglob("*") if file.is_file() and not file.name.endswith("-shm")]
    return {file: file.read_bytes() for file in files}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "campaign"


@pytest.fixture
def recorder(path: Path) -> Iterator[Recorder]:
    with recording(path) as recorder:
        yield recorder


class TestOpening:
    def test_runs_are_begun_in_folders_of_their_own_below_the_job(self, path, recorder) -> None:
        opened = recorder.open(ask("b", "a"))
        assert anonymous(opened) == Opened(epoch=1, durable=[0, 0], platform={})
        assert opened.identity == JobFolder.open(path).identity != ""
        assert (JobFolder.open(path).name, JobFolder.open(path).epoch) == (JOB, 1)
        for run in "ab":
            folder = RunFolder.open(path / "runs" / run)
            assert (folder.run, folder.spec, folder.job.path) == (run, SPEC, path)

    def test_runs_join_an_epoch_and_another_epoch_ends_it(self, path, recorder) -> None:
        assert recorder.open(ask("a")).epoch == 1
        recorder.add_rows(rows("a", 0, 30), 0.0)
        recorder.commit("a")
        opened = anonymous(recorder.open(ask("b", "a", epoch=1)))
        assert opened == Opened(epoch=1, durable=[0, 30], platform={})
        assert recorder.open(ask("c")).epoch == 2
        with pytest.raises(Refused, match="epoch 1 is over: another coordinator took over with 2"):
            recorder.open(ask("d", epoch=1))
        assert not (path / "runs" / "d").exists()
        assert JobFolder.open(path).epoch == 2

    def test_a_recorder_that_comes_back_gives_the_next_epoch(self, path: Path) -> None:
        for epoch, durable, platform in ((1, 0, {}), (2, 30, HERE), (3, 30, HERE)):
            with recording(path) as recorder:
                opened = anonymous(recorder.open(ask("a")))
                assert opened == Opened(epoch=epoch, durable=[durable], platform=platform)
                assert JobFolder.open(path).epoch == epoch
                if epoch == 1:
                    record(recorder, "a", 30, HERE)

    def test_a_new_epoch_finds_what_waited_in_the_one_before_on_the_disk(self, recorder) -> None:
        recorder.open(ask("a", "b"))
        recorder.add_rows(rows("a", 0, 10), 0.0)
        assert recorder.open(ask("b", "a")).durable == [0, 10]
        recorder.step(0.0)
        assert recorder.deadline == inf

    @pytest.mark.parametrize(
        ("asked", "words"),
        [
            (ask("run"), "holds a campaign, the coordinator opens a run of its own"),
            (Open(job="cubes", runs=ask("b").runs), "job 'mugs', not of 'cubes'"),
        ],
    )
    def test_what_cannot_be_opened_together_is_refused(self, recorder, asked, words) -> None:
        recorder.open(ask("a"))
        with pytest.raises(Refused, match=words):
            recorder.open(asked)
        assert recorder.epoch == 1

    def test_where_one_run_is_refused_none_is_begun(self, path, recorder) -> None:
        other = RunSpec(gripper="panda", object="mug", seed=1)
        recorder.open(ask("a"))
        wrong = (ask("a", spec=other).runs[0], ask("a", scene="0" * 64).runs[0])
        for run, words in zip(wrong, ("another spec: seed differ", "run of scene"), strict=True):
            with pytest.raises(Refused, match=words):
                recorder.open(Open(job=JOB, runs=[*ask("b").runs, run], epoch=1))
        (path / "runs" / "c").mkdir()
        (path / "runs" / "c" / "file").touch()
        with pytest.raises(FolderError, match="holds other files"):
            recorder.open(ask("b", "c"))
        assert not (path / "runs" / "b").exists()
        assert JobFolder.open(path).epoch == 1

    def test_runs_that_a_coordinator_began_on_this_machine_are_gone_on_with(self, path: Path) -> None:
        RunFolder.add(JobFolder.create(path, JOB, {"campaign.toml": b""}), "a", SPEC, BUNDLE)
        with recording(path) as recorder:
            with pytest.raises(Refused, match="run of scene"):
                recorder.open(ask("a", scene="0" * 64))
            recorder.open(ask("a"))
            assert recorder.missing_scenes == []


class TestPlatforms:
    def test_a_run_of_another_platform_than_the_jobs_is_refused(self, path: Path) -> None:
        with recording(path) as recorder:
            recorder.open(ask("a", "b"))
            record(recorder, "a", 10, HERE)
            record(recorder, "b", 10, ELSEWHERE)
        for epoch in (0, 1):
            words = r"run 'b' was .*: pybullet 3\.2\.6 instead of 3\.2\.7"
            with recording(path) as recorder, pytest.raises(Refused, match=words):
                recorder.open(ask("a", "b", epoch=epoch))

    def test_the_platform_of_recorded_runs_is_that_of_a_new_one(self, path: Path) -> None:
        with recording(path) as recorder:
            recorder.open(ask("b"))
            record(recorder, "b", 10, HERE)
            assert recorder.open(ask("a", epoch=1)).platform == HERE
        with recording(path) as recorder:
            assert recorder.open(ask("a", epoch=1)).platform == HERE
            recorder.add_rows(rows("a", 0, 10), 0.0)
            recorder.commit("a")
        with Journal.open(path / "runs" / "a") as journal:
            assert journal.platform == HERE

    def test_the_platform_of_runs_in_two_engines_has_the_entries_of_both(self, path: Path) -> None:
        both, in_mujoco = HERE | {"mujoco": "4.0.1"}, msgspec.structs.replace(SPEC, engine="mujoco")
        with recording(path) as recorder:
            recorder.open(ask("a", spec=in_mujoco))
            record(recorder, "a", 10, both)
            recorder.open(ask("b", epoch=1))
            record(recorder, "b", 10, both)
        with recording(path) as recorder:
            assert recorder.open(ask("c", epoch=1)).platform == both


class TestRows:
    def test_rows_of_each_run_wait_for_their_own_commit(self, recorder) -> None:
        recorder.open(ask("a", "b"))
        recorder.add_rows(rows("a", 0, 10), 1.0)
        recorder.add_rows(rows("b", 0, 20), 1.1)
        recorder.add_rows(rows("a", 10, 30), 1.2)
        assert recorder.deadline == 1.0 + GROUP_SECONDS
        assert [report.run for report in recorder.step(1.0 + GROUP_SECONDS)] == ["a"]
        assert (recorder.writers["a"].durable, recorder.writers["b"].durable) == (30, 0)
        assert [report.run for report in recorder.step(1.1 + GROUP_SECONDS)] == ["b"]

    @pytest.mark.parametrize(("column", "number"), [("fitness", 3e38), ("outcome", 255), ("genome", 1e30)])
    def test_rows_with_a_number_that_cannot_be_are_not_recorded(self, recorder, column, number) -> None:
        recorder.open(ask("a"))
        spoilt = ROWS[:10].copy()
        spoilt[column][3] = number
        message = slice_to_message(JournalSlice(0, spoilt), "a", 1, SHAPE)
        with pytest.raises(
            MessageError, match=f"column '{column}' holds {np.float32(number):g}".replace("+", ".")
        ):
            recorder.add_rows(message, 0.0)
        assert recorder.add_rows(rows("a", 0, 10), 0.0)

    def test_a_recorder_that_comes_back_finds_a_run_by_its_name(self, path: Path) -> None:
        with recording(path) as recorder:
            recorder.open(ask("a", "b"))
            recorder.add_rows(rows("a", 0, 10), 0.0)
            recorder.commit("a")
        with recording(path) as recorder:
            assert recorder.writers == {}
            assert recorder.page(Log(run="a", first=5, limit=100)).n == 5
            assert recorder.add_rows(rows("a", 5, 30), 0.0)
            assert not recorder.add_rows(rows("b", 1, 2), 0.0)
            recorder.commit("a")
            for unknown in ("c", "run"):
                with pytest.raises(Refused, match=f"no journal of run '{unknown}'"):
                    recorder.add_rows(rows(unknown, 0, 1), 0.0)
        assert journalled(path, "a") == ROWS[:30].tobytes()

    def test_a_hundred_runs_with_rows_that_wait_need_four_open_journals(self, path: Path) -> None:
        names = [f"run-{number}" for number in range(100)]
        before = open_files()
        with recording(path, open_journals=4) as recorder:
            assert len(recorder.open(ask(*names)).durable) == 100
            for run in names:
                recorder.add_rows(rows(run, 0, 100), 0.0)
            for run in names:
                recorder.commit(run)
                assert open_files() <= before + 1 + 3 * 4
            assert {recorder.writers[run].durable for run in names} == {100}
        assert open_files() == before
        assert {journalled(path, run) for run in names} == {ROWS.tobytes()}

    def test_a_scene_is_stored_once_for_each_run_that_misses_it(self, path: Path) -> None:
        RunFolder.add(JobFolder.create(path, JOB), "b", SPEC, BUNDLE)
        with recording(path) as recorder:
            recorder.open(ask("a", "b", "c"))
            recorder.open(ask("d", epoch=1, scene="0" * 64))
            assert recorder.missing_scenes == sorted([BUNDLE.digest, "0" * 64])
            recorder.add_scene(BUNDLE.digest, SCENE)
            assert recorder.missing_scenes == ["0" * 64]
        assert RunFolder(path / "runs" / "c").bundle() == BUNDLE


class TestFinishedRuns:
    """`SHORT` ends a run with its 30th row."""

    SHORT = msgspec.structs.replace(SPEC, evaluations=30)

    def finished(self, path: Path, run: str, spec: RunSpec) -> int | None:
        """Evaluations of a run as the index has them; None: it is not there."""
        index = FinishedRuns(path)
        index.refresh()
        known = index.find(path / "runs" / run, spec)
        return known.evaluations if known else None

    def test_a_run_whose_end_is_put_off_is_not_in_the_index_before_that_end(self, path, recorder) -> None:
        longer = msgspec.structs.replace(SPEC, evaluations=40)
        recorder.open(ask("a", spec=self.SHORT))
        record(recorder, "a", 30, HERE)
        recorder.open(ask("a", spec=longer))
        assert self.finished(path, "a", longer) is None
        recorder.add_rows(rows("a", 30, 40, recorder.epoch), 0.0)
        recorder.commit("a")
        assert self.finished(path, "a", longer) == 40

    def test_a_crash_before_the_line_is_written_loses_no_finished_run(self, path, monkeypatch) -> None:
        monkeypatch.setattr(FinishedRuns, "add", lambda *_: None)
        with recording(path) as recorder:
            recorder.open(ask("a", spec=self.SHORT))
            record(recorder, "a", 30, HERE)
            assert self.finished(path, "a", self.SHORT) is None
            monkeypatch.undo()
            extent = CampaignRunQueue(JobFolder(path), {"a": self.SHORT, "b": self.SHORT}).extent
        assert (extent.runs_done, list(extent.budgets)) == (1, ["b"])

    def test_what_is_kept_of_runs_is_bounded_however_many_are_finished(self, path, recorder) -> None:
        recorder.open(ask("a", spec=self.SHORT))
        for number in range(50):
            run, now = f"run-{number}", 20.0 * number
            recorder.open(ask(run, epoch=1, spec=self.SHORT, scene=self.scene_of(path, run)))
            recorder.take(sample_of(rows(run, 0, 30)), now)
            while recorder.deadline < now + 20.0:
                recorder.step(recorder.deadline)
        assert recorder.writers.keys() == {"a"}
        assert recorder._news == set(recorder._waiting) == set()
        assert len(recorder._journals._open) <= 1
        assert self.finished(path, "run-49", self.SHORT) == 30

    def scene_of(self, path: Path, run: str) -> str:
        """Add the folder of a run with its scene, as a coordinator on this machine does."""
        RunFolder.add(JobFolder(path), run, self.SHORT, BUNDLE)
        return BUNDLE.digest


def test_an_opening_does_not_wait_for_the_commits_of_all_runs(path: Path, recorder: Recorder) -> None:
    names = [f"run-{number}" for number in range(3 * COMMITS_AT_ONCE)]
    recorder.open(ask(*names))
    for run in names:
        recorder.add_rows(rows(run, 0, 10), 0.0)
    steps = []
    while recorder.deadline < inf:
        steps.append(len(recorder.step(GROUP_SECONDS)))
    assert steps == [COMMITS_AT_ONCE] * 3


def sample_of(message: Recordable) -> Sample:
    return Sample(Keys(JOB).outcome(message.epoch), messages.encode(message), messages.encoding(Recordable))
