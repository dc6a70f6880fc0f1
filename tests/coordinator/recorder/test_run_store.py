from pathlib import Path

import msgspec
import pytest
from tests.coordinator.recorder.fakes import BUNDLE, JOB, SCENE, SHAPE, SPEC, anonymous, make_rows

from qdgrasp_coordinator.recorder.run_store import RunStore
from qdgrasp_coordinator.recorder.run_writer import GROUP_SECONDS, Arrival
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.journal_slice import JournalSlice, slice_to_message
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import EndsTooSoon, FolderError, Refused
from qdgrasp_protocol.messages import Log, Open, Opened, OpenRun, Platform, Recordable
from qdgrasp_protocol.spec import RunSpec, to_toml

ROWS = make_rows(100)
HERE, ELSEWHERE = {"pybullet": "3.2.7"}, {"pybullet": "3.2.6"}


def ask(*runs: str, epoch: int = 0, spec: RunSpec = SPEC, scene: str = BUNDLE.digest) -> Open:
    opened = [
        OpenRun(run=run, spec=to_toml(spec).encode(), scene=scene, genes=7, joints=2, descriptors=3)
        for run in runs
    ]
    return Open(job=JOB, runs=opened, epoch=epoch)


def rows(run: str, first: int, stop: int, epoch: int = 1) -> Recordable:
    return slice_to_message(JournalSlice(first, ROWS[first:stop]), run, epoch, SHAPE)


def record(books: RunStore, run: str, stop: int, platform: dict[str, str]) -> None:
    books.set_platform(Platform(epoch=books.epoch, platform=platform))
    books.take(rows(run, 0, stop, books.epoch), 0.0)
    books.commit(run)


def journalled(path: Path, run: str) -> bytes:
    with Journal.open(path / "runs" / run) as journal:
        return journal.rows(0, 1000).tobytes()


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def content(folder: Path) -> dict[Path, bytes]:
    """What all files hold, but for what readers share in memory."""
    files = [file for file in folder.rglob("*") if file.is_file() and not file.name.endswith("-shm")]
    return {file: file.read_bytes() for file in files}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "campaign"


class TestOpening:
    def test_runs_are_begun_in_folders_of_their_own_below_the_job(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            opened = books.open(ask("b", "a"))
        assert anonymous(opened) == Opened(epoch=1, durable=[0, 0], platform={})
        assert opened.identity == JobFolder.open(path).identity != ""
        assert (JobFolder.open(path).name, JobFolder.open(path).epoch) == (JOB, 1)
        for run in "ab":
            folder = RunFolder.open(path / "runs" / run)
            assert (folder.run, folder.spec, folder.job.path) == (run, SPEC, path)

    def test_runs_join_a_turn_and_another_turn_ends_it(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            assert books.open(ask("a")).epoch == 1
            books.take(rows("a", 0, 30), 0.0)
            books.commit("a")
            opened = anonymous(books.open(ask("b", "a", epoch=1)))
            assert opened == Opened(epoch=1, durable=[0, 30], platform={})
            assert books.open(ask("c")).epoch == 2
            with pytest.raises(Refused, match="epoch 1 is over: another coordinator took over with 2"):
                books.open(ask("d", epoch=1))
        assert not (path / "runs" / "d").exists()
        assert JobFolder.open(path).epoch == 2

    @pytest.mark.parametrize("is_committed", [True, False])
    def test_an_end_before_what_is_recorded_is_refused_and_nothing_is_written(
        self, path: Path, is_committed: bool
    ) -> None:
        counted = msgspec.structs.replace(SPEC, overlaps="count")
        sooner = msgspec.structs.replace(counted, evaluations=29)
        with RunStore(path, JOB) as books:
            books.open(ask("a", spec=counted))
            books.take(rows("a", 0, 30), 0.0)
            if is_committed:
                books.commit("a")
            before = content(path)
            with pytest.raises(
                EndsTooSoon, match="runs/a cannot end as is asked: evaluations must be at least 30"
            ):
                books.open(ask("b", "a", spec=sooner))
            assert content(path) == before
            assert books.epoch == 1
            books.commit("a")
            exactly = msgspec.structs.replace(counted, evaluations=30)
            assert books.open(ask("a", spec=exactly)).durable == [30]
        assert RunFolder(path / "runs" / "a").spec == exactly

    def test_a_turn_that_is_ahead_of_the_disk_is_adopted(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            assert books.open(ask("a", epoch=7)).epoch == 7
        with RunStore(path, JOB) as books:
            assert books.open(ask("b", epoch=9)).epoch == 9
            assert books.open(ask("b")).epoch == 10
        assert JobFolder.open(path).epoch == 10

    def test_a_run_that_is_opened_again_in_its_turn_keeps_what_waits(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a"))
            books.take(rows("a", 0, 10), 0.0)
            assert books.open(ask("a", epoch=1)).durable == [0]
            books.commit("a")
            assert books.durable("a") == 10

    def test_a_new_turn_finds_what_waited_in_the_one_before_on_the_disk(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a", "b"))
            books.take(rows("a", 0, 10), 0.0)
            assert books.open(ask("b", "a")).durable == [0, 10]
            assert books.due(1e9) == []

    @pytest.mark.parametrize(
        ("asked", "words"),
        [
            (ask(), "expected different runs"),
            (ask("b", "b"), "expected different runs"),
            (ask("b", "run"), "has no others beside it"),
            (ask("run"), "holds a campaign, the coordinator opens a run of its own"),
            (Open(job="cubes", runs=ask("b").runs), "job 'mugs', not of 'cubes'"),
        ],
    )
    def test_what_cannot_be_opened_together_is_refused(self, path: Path, asked: Open, words: str) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a"))
            with pytest.raises(Refused, match=words):
                books.open(asked)
            assert books.epoch == 1

    def test_where_one_run_is_refused_none_is_begun(self, path: Path) -> None:
        other = RunSpec(gripper="panda", object="mug", seed=1)
        with RunStore(path, JOB) as books:
            books.open(ask("a"))
            wrong = (ask("a", spec=other).runs[0], ask("a", scene="0" * 64).runs[0])
            for run, words in zip(wrong, ("another spec: seed differ", "run of scene"), strict=True):
                with pytest.raises(Refused, match=words):
                    books.open(Open(job=JOB, runs=[*ask("b").runs, run], epoch=1))
            (path / "runs" / "c").mkdir()
            (path / "runs" / "c" / "file").touch()
            with pytest.raises(FolderError, match="holds other files"):
                books.open(ask("b", "c"))
        assert not (path / "runs" / "b").exists()
        assert JobFolder.open(path).epoch == 1

    def test_a_run_of_its_own_is_never_mixed_with_others(self, path: Path) -> None:
        RunFolder.create(path, SPEC, BUNDLE, job=JOB)
        with (
            RunStore(path, JOB) as books,
            pytest.raises(Refused, match="run of its own, the coordinator opens a ca"),
        ):
            books.open(ask("a"))
        assert not (path / "runs").exists()

    def test_runs_that_a_coordinator_began_on_this_machine_are_gone_on_with(self, path: Path) -> None:
        job = JobFolder.create(path, JOB, {"campaign.toml": b""})
        RunFolder.add(job, "a", SPEC, BUNDLE)
        with RunStore(path, JOB) as books:
            with pytest.raises(Refused, match="run of scene"):
                books.open(ask("a", scene="0" * 64))
            books.open(ask("a"))
            assert books.missing_scenes == []


class TestPlatforms:
    def test_a_run_of_another_platform_than_the_jobs_is_refused(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a", "b"))
            record(books, "a", 10, HERE)
            record(books, "b", 10, ELSEWHERE)
        for epoch in (0, 1):
            words = r"run 'b' was .*: pybullet 3\.2\.6 instead of 3\.2\.7"
            with RunStore(path, JOB) as books, pytest.raises(Refused, match=words):
                books.open(ask("a", "b", epoch=epoch))

    def test_the_platform_of_recorded_runs_is_that_of_a_new_one(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("b"))
            record(books, "b", 10, HERE)
            assert books.open(ask("a", epoch=1)).platform == HERE
        with RunStore(path, JOB) as books:
            assert books.open(ask("a", epoch=1)).platform == HERE
            books.take(rows("a", 0, 10), 0.0)
            books.commit("a")
        with Journal.open(path / "runs" / "a") as journal:
            assert journal.platform == HERE

    def test_a_platform_without_rows_binds_nobody(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a"))
            books.set_platform(Platform(epoch=1, platform=HERE))
            assert books.open(ask("b")).platform == {}


class TestRows:
    def test_rows_of_each_run_wait_for_their_own_commit(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a", "b"))
            books.take(rows("a", 0, 10), 1.0)
            books.take(rows("b", 0, 20), 1.1)
            books.take(rows("a", 10, 30), 1.2)
            assert books.deadline == 1.0 + GROUP_SECONDS
            assert books.due(1.0 + GROUP_SECONDS) == ["a"]
            books.commit("a")
            assert (books.durable("a"), books.durable("b")) == (30, 0)
            assert books.due(1.1 + GROUP_SECONDS) == ["b"]

    def test_one_epoch_holds_for_all_runs(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a", "b"))
            assert books.take(rows("a", 0, 10, epoch=5), 0.0) is Arrival.TAKEN
            assert books.take(rows("b", 0, 10, epoch=4), 0.0) is Arrival.STALE
            books.commit("a")
        assert JobFolder.open(path).epoch == 5

    def test_a_recorder_that_comes_back_finds_a_run_by_its_name(self, path: Path) -> None:
        with RunStore(path, JOB) as books:
            books.open(ask("a", "b"))
            books.take(rows("a", 0, 10), 0.0)
            books.commit("a")
        with RunStore(path, JOB) as books:
            assert books.runs == []
            assert books.page(Log(run="a", first=5, limit=100)).n == 5
            assert books.take(rows("a", 5, 30), 0.0) is Arrival.TAKEN
            assert books.take(rows("b", 1, 2), 0.0) is Arrival.GAP
            books.commit("a")
            for unknown in ("c", "run"):
                with pytest.raises(Refused, match=f"no journal of run '{unknown}'"):
                    books.take(rows(unknown, 0, 1), 0.0)
        assert journalled(path, "a") == ROWS[:30].tobytes()

    def test_a_hundred_runs_with_rows_that_wait_need_four_open_journals(self, path: Path) -> None:
        names = [f"run-{number}" for number in range(100)]
        before = open_files()
        with RunStore(path, JOB, open_journals=4) as books:
            assert len(books.open(ask(*names)).durable) == 100
            for run in names:
                books.take(rows(run, 0, 100), 0.0)
            for run in names:
                books.commit(run)
                assert open_files() <= before + 1 + 3 * 4
            assert {books.durable(run) for run in names} == {100}
        assert open_files() == before
        assert {journalled(path, run) for run in names} == {ROWS.tobytes()}

    def test_a_scene_is_stored_once_for_each_run_that_misses_it(self, path: Path) -> None:
        job = JobFolder.create(path, JOB)
        RunFolder.add(job, "b", SPEC, BUNDLE)
        with RunStore(path, JOB) as books:
            books.open(ask("a", "b", "c"))
            books.open(ask("d", epoch=1, scene="0" * 64))
            assert books.missing_scenes == sorted([BUNDLE.digest, "0" * 64])
            books.add_scene(BUNDLE.digest, SCENE)
            assert books.missing_scenes == ["0" * 64]
        assert RunFolder(path / "runs" / "c").bundle() == BUNDLE
