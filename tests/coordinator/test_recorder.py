import hashlib
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO

import numpy as np
import pytest

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.digest import digest
from qdgrasp_coordinator.folder import RunFolder
from qdgrasp_coordinator.journal import Journal
from qdgrasp_coordinator.journal_writer import JournalWriter
from qdgrasp_coordinator.record import RecorderLink
from qdgrasp_coordinator.recorder import RecorderService
from qdgrasp_coordinator.stretch import Stretch, from_message, to_message
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import DiskFull, FolderError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.local_bus import LocalNetwork
from qdgrasp_protocol.messages import (
    Failure,
    Log,
    Message,
    Open,
    Opened,
    OpenRun,
    Platform,
    Recordable,
    Recorded,
)
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_protocol.zenoh_bus import ZenohBus, free_endpoint

SHAPE = Shape(genes=7, joints=2)
SPEC = RunSpec(gripper="panda", object="mug", evaluations=1000)
SCENE = b"a scene" * 200_000
BUNDLE = Bundle(SCENE, hashlib.sha256(SCENE).hexdigest())
JOB = "mugs"
SOON = 20.0  # seconds that anything may take that is to happen


def make_rows(n: int) -> Rows:
    rows = SHAPE.empty(n)
    random = np.random.default_rng(0)
    rows["index"], rows["outcome"] = np.arange(n), random.integers(Outcome.ERROR, Outcome.HELD, n)
    rows["genome"] = random.uniform(-1, 1, rows["genome"].shape)
    return rows


class Coordinator:
    """What a recorder sees of a coordinator."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._keys = Keys(JOB)
        self._reports: SimpleQueue[Recorded] = SimpleQueue()
        self._recorder = threading.Event()
        self.epoch = 0
        bus.watch(
            self._keys.recorder_token(), lambda _, alive: (self._recorder.clear, self._recorder.set)[alive]()
        )
        bus.subscribe(self._keys.recorded, lambda s: self._reports.put(codec.decode(s.payload, Recorded)))

    def open(self, toml: str = to_toml(SPEC), job: str = JOB, **changes: object) -> Opened:
        """Open the run as soon as a recorder is there."""
        question = codec.encode(Open(job=job, runs=[self.question(toml, **changes)]))
        opened = codec.decode(self.ask(self._keys.open, question), Opened)
        self.epoch = opened.epoch
        return opened

    def question(self, toml: str = to_toml(SPEC), **changes: object) -> OpenRun:
        """What is asked of the recorder when the run is opened."""
        values: dict[str, object] = {"run": "run", "spec": toml.encode(), "scene": BUNDLE.digest}
        values |= {"genes": SHAPE.genes, "joints": SHAPE.joints, "descriptors": SHAPE.descriptors}
        return OpenRun(**(values | changes))  # type: ignore[arg-type]

    def meet(self) -> None:
        """Wait until a recorder is there."""
        assert self._recorder.wait(SOON), "no recorder came"

    def ask(self, key: str, payload: bytes) -> bytes:
        """Ask the recorder; one that is killed may still seem to be there for a moment."""
        deadline = time.monotonic() + SOON
        while True:
            self.meet()
            try:
                return self._bus.ask(key, payload)
            except NoReply:
                assert time.monotonic() < deadline, "no recorder answered"

    def send(self, rows: Rows, first: int, stop: int, *, epoch: int = 0, **beside: object) -> None:
        stretch = Stretch(first, rows[first:stop], **beside)  # type: ignore[arg-type]
        self.put(to_message(stretch, "run", epoch or self.epoch, SHAPE))

    def put(self, message: Message) -> None:
        key, kind = self._keys.outcome(self.epoch), type(message)
        self._bus.put(key, codec.encode(message), encoding=codec.encoding(kind))

    def page(self, first: int, limit: int) -> Stretch:
        answer = self.ask(self._keys.log, codec.encode(Log(run="run", first=first, limit=limit)))
        return from_message(codec.decode(answer, Recordable), SHAPE)

    def hears(self, condition: Callable[[Recorded], bool]) -> Recorded:
        """The next report of which the condition holds."""
        deadline = time.monotonic() + SOON
        while True:
            try:
                report = self._reports.get(timeout=max(0.0, deadline - time.monotonic()))
            except Empty:
                raise AssertionError("no such report was heard") from None
            if condition(report):
                return report

    def hears_durable(self, number: int) -> Recorded:
        return self.hears(lambda report: report.durable == number and report.epoch == self.epoch)


class Running:
    """A recorder that runs in a thread."""

    def __init__(self, bus: Bus, path: Path, disk_wait: float) -> None:
        self.stop = Stop()
        self.error: Exception | None = None
        self._service = RecorderService(bus, self.stop, job=JOB, path=path, disk_wait=disk_wait)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._service.run()
        except Exception as error:  # noqa: BLE001 - the test looks at it
            self.error = error

    def ends(self) -> None:
        self._thread.join(SOON)
        assert not self._thread.is_alive()


@contextmanager
def recording(network: LocalNetwork, path: Path, disk_wait: float = 60.0) -> Iterator[Running]:
    """A recorder until the context ends, by SIGTERM."""
    with network.session() as bus:
        running = Running(bus, path, disk_wait)
        try:
            yield running
        finally:
            running.stop.set(signal.SIGTERM)
            running.ends()


@pytest.fixture
def network() -> LocalNetwork:
    return LocalNetwork()


@pytest.fixture
def coordinator(network: LocalNetwork) -> Coordinator:
    return Coordinator(network.session())


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "run", SPEC, BUNDLE, job=JOB)


class TestOpening:
    def test_each_opening_has_the_next_epoch_and_it_is_on_the_disk(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        for epoch in (1, 2, 3):
            with recording(network, folder.path):
                assert coordinator.open() == Opened(epoch=epoch, durable=[0], platform={})
                assert RunFolder.open(folder.path).job.epoch == epoch

    def test_a_run_goes_on_where_its_journal_ends_on_its_platform(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        with recording(network, folder.path):
            coordinator.open()
            coordinator.put(Platform(epoch=1, platform={"pybullet": "3.2.7"}))
            coordinator.send(make_rows(30), 0, 30)
            coordinator.hears_durable(30)
        with recording(network, folder.path):
            assert coordinator.open() == Opened(epoch=2, durable=[30], platform={"pybullet": "3.2.7"})

    def test_a_larger_budget_is_taken_over_into_spec_and_journal(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        longer = RunSpec(gripper="panda", object="mug", evaluations=2000)
        with recording(network, folder.path):
            coordinator.open()
            coordinator.open(to_toml(longer))
        assert folder.spec == longer
        with folder.journal() as journal:
            assert journal.spec == longer

    def test_another_spec_or_scene_or_job_is_refused_with_the_difference(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        other = RunSpec(gripper="panda", object="mug", seed=1, mutation_sigma=0.2)
        for opened_before in (False, True):
            with recording(network, folder.path):
                if opened_before:
                    coordinator.open()
                with pytest.raises(Refused, match="another spec: seed, mutation_sigma differ"):
                    coordinator.open(to_toml(other))
                with pytest.raises(Refused, match="run of scene"):
                    coordinator.open(scene="0" * 64)
                with pytest.raises(Refused, match="runs of job 'mugs', not of 'cubes'"):
                    coordinator.open(job="cubes")
                with pytest.raises(Refused, match="unknown key 'sed'"):
                    coordinator.open("gripper = 'a'\nobject = 'b'\nsed = 1")
        assert folder.job.epoch == 1

    def test_a_recorder_elsewhere_begins_the_folder_and_fetches_the_scene(
        self, network: LocalNetwork, coordinator: Coordinator, tmp_path: Path
    ) -> None:
        with network.session() as bus, recording(network, tmp_path / "new"):
            bus.answer(Keys(JOB).asset(), lambda query: chunks.answer(query, SCENE, BUNDLE.digest))
            coordinator.open()
            coordinator.hears_durable(0)
            coordinator.page(0, 1)  # answered in the same thread, after the scene was fetched
        folder = RunFolder.open(tmp_path / "new")
        assert folder.bundle() == BUNDLE
        assert (folder.spec, folder.job.name, folder.job.epoch) == (SPEC, JOB, 1)


class TestRecording:
    def test_rows_become_durable_and_come_back_in_pages(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(5000)
        with recording(network, folder.path):
            coordinator.open()
            for first in range(0, 5000, 1000):
                coordinator.send(rows, first, first + 1000, cpu_seconds=1.0)
            coordinator.hears_durable(5000)
            pages = [coordinator.page(first, 4096).rows for first in (0, 4096)]
            assert np.concatenate(pages).tobytes() == rows.tobytes()
            assert len(coordinator.page(5000, 10)) == 0
        with folder.journal() as journal:
            assert journal.cpu_seconds == pytest.approx(5.0)

    def test_lost_repeated_and_overlapping_messages_leave_each_row_once(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(100)
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(rows, 50, 100)
            coordinator.hears_durable(0)
            for first, stop in ((0, 30), (0, 30), (20, 60), (10, 20), (40, 100), (0, 100)):
                coordinator.send(rows, first, stop)
            coordinator.hears_durable(100)
        with folder.journal() as journal:
            assert journal.rows(0, 1000).tobytes() == rows.tobytes()

    def test_a_duplicate_is_answered_with_what_is_durable(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(10)
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(rows, 0, 10)
            coordinator.hears_durable(10)
            coordinator.send(rows, 0, 10)
            coordinator.hears_durable(10)

    def test_a_replaced_coordinators_rows_are_refused(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(10)
        with recording(network, folder.path):
            coordinator.open()
            assert coordinator.open().epoch == 2
            coordinator.send(rows, 0, 10, epoch=1)
            assert coordinator.hears(lambda report: report.epoch == 2).durable == 0
            coordinator.send(rows, 0, 5)
            coordinator.hears_durable(5)

    def test_what_is_not_of_the_protocol_is_dropped(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(10)
        wide = Shape(genes=8, joints=2)
        with network.session() as bus, recording(network, folder.path):
            coordinator.open()
            for payload, kind in ((b"\x90" * 1000, Recordable), (b"", Platform), (b"\xc1", Recordable)):
                bus.put(Keys(JOB).outcome(1), payload, encoding=codec.encoding(kind))
            bus.put(Keys(JOB).outcome(1), b"text", encoding="text/plain")
            coordinator.put(to_message(Stretch(0, wide.empty(3)), "run", 1, wide))
            failure = (Failure(row=3, reason="behind the end"),)
            coordinator.send(rows, 0, 3, failures=failure)
            coordinator.send(rows, 0, 10)
            coordinator.hears_durable(10)

    def test_reasons_of_errors_are_recorded_and_replayed(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows, failures = make_rows(10), (Failure(row=1, reason="the child aborted"),)
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(rows, 0, 4)
            coordinator.send(rows, 4, 10, failures=failures)
            coordinator.hears_durable(10)
            assert coordinator.page(5, 3).failures == (Failure(row=0, reason="the child aborted"),)

    def test_a_recorder_that_comes_back_goes_on_with_the_same_coordinator(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(20)
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(rows, 0, 10)
            coordinator.hears_durable(10)
        with recording(network, folder.path):
            coordinator.meet()
            coordinator.send(rows, 10, 20)
            coordinator.hears_durable(20)
        with folder.journal() as journal:
            assert journal.rows(0, 100).tobytes() == rows.tobytes()

    def test_the_platform_reaches_a_recorder_that_was_away_when_it_became_known(
        self, network: LocalNetwork, folder: RunFolder
    ) -> None:
        link, run = RecorderLink(network.session(), JOB, SHAPE), Coordinator(network.session())
        with recording(network, folder.path):
            run.meet()
            link.open(run.question(), 0, lambda: None)
        link.set_platform({"pybullet": "3.2.7"})
        link.push(Stretch(0, make_rows(10)))
        link.tick(0.0)
        with recording(network, folder.path):
            run.meet()
            link.recorder_up(0.1)
            link.tick(0.2)
            run.hears(lambda report: report.durable == 10)
        with folder.journal() as journal:
            assert journal.platform == {"pybullet": "3.2.7"}

    def test_a_restored_disk_is_reported_to_the_coordinator_that_is_ahead_of_it(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        rows = make_rows(20)
        with recording(network, folder.path):
            coordinator.open()
        coordinator.epoch = 7
        with recording(network, folder.path):
            coordinator.meet()
            coordinator.send(rows, 0, 10)
            coordinator.hears_durable(10)
        assert folder.job.epoch == 7

    def test_what_waits_when_the_recorder_is_asked_to_stop_is_committed(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(make_rows(10), 0, 10)
        with folder.journal() as journal:
            assert journal.count == 10

    def test_reading_before_the_run_is_opened_is_refused(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder
    ) -> None:
        with recording(network, folder.path), pytest.raises(Refused, match="was not opened"):
            coordinator.page(0, 10)


class TestFolders:
    def test_a_folder_in_use_another_jobs_or_with_other_files_ends_the_recorder(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder, tmp_path: Path
    ) -> None:
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / "file").touch()
        foreign = RunFolder.create(tmp_path / "foreign", SPEC, BUNDLE, job="cubes").path
        with folder.job.lock():
            for path, words in (
                (folder.path, "is in use"),
                (tmp_path / "other", "holds other files"),
                (foreign, "is of job 'cubes', not 'mugs'"),
            ):
                with recording(network, path) as running:
                    running.ends()
                    assert isinstance(running.error, FolderError)
                    assert words in str(running.error)


class TestFullDisk:
    @pytest.fixture
    def room(self, monkeypatch: pytest.MonkeyPatch) -> threading.Event:
        """While it is not set, journals may not grow."""
        room, append = threading.Event(), JournalWriter.append

        def limited(journal: JournalWriter, stretch: Stretch, epoch: int, now: float) -> None:
            pages = 1_000_000 if room.is_set() else 1
            journal._database.execute(f"PRAGMA max_page_count = {pages}")
            append(journal, stretch, epoch, now)

        monkeypatch.setattr(JournalWriter, "append", limited)
        monkeypatch.setattr("qdgrasp_coordinator.room.RETRY_INTERVAL", 0.02)
        return room

    def test_it_is_said_and_waited_for_and_nothing_is_lost(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder, room: threading.Event
    ) -> None:
        rows = make_rows(3000)
        room.set()
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(rows, 0, 1000)
            coordinator.hears_durable(1000)
            room.clear()
            coordinator.send(rows, 1000, 2000)
            report = coordinator.hears(lambda report: bool(report.trouble))
            assert report.durable == 1000
            assert "no room" in report.trouble
            coordinator.send(rows, 1000, 3000)
            assert coordinator.page(0, 4096).rows.tobytes() == rows[:1000].tobytes()
            room.set()
            assert not coordinator.hears_durable(3000).trouble
        with folder.journal() as journal:
            assert journal.rows(0, 4096).tobytes() == rows.tobytes()

    def test_after_its_patience_the_recorder_ends_and_names_resume(
        self, network: LocalNetwork, coordinator: Coordinator, folder: RunFolder, room: threading.Event
    ) -> None:
        with recording(network, folder.path, disk_wait=0.2) as running:
            coordinator.open()
            coordinator.send(make_rows(1000), 0, 1000)
            running.ends()
            assert isinstance(running.error, DiskFull)
            assert running.error.exit_code == 2
            assert f"`qdgrasp resume {folder.path}` goes on" in str(running.error)
        with folder.journal() as journal:
            assert journal.count == 0


class TestCommand:
    """`qdgrasp-recorder` as a process of its own, over zenoh."""

    @pytest.fixture
    def endpoint(self) -> str:
        return free_endpoint()

    @pytest.fixture
    def router(self, endpoint: str) -> Iterator[ZenohBus]:
        with ZenohBus.router(endpoint) as bus:
            yield bus

    @contextmanager
    def process(
        self, endpoint: str, path: Path, *more: str, stderr: IO[bytes] | int = subprocess.PIPE
    ) -> Iterator["subprocess.Popen[bytes]"]:
        arguments = ["--connect", endpoint, "--job", JOB, "--out", str(path), *more]
        command = [sys.executable, "-m", "qdgrasp_coordinator.cli.recorder", *arguments]
        with subprocess.Popen(command, stderr=stderr) as process:
            try:
                yield process
            finally:
                process.kill()

    def test_a_signal_ends_it_with_its_code_and_a_kill_loses_nothing_durable(
        self, endpoint: str, router: ZenohBus, folder: RunFolder
    ) -> None:
        coordinator, rows = Coordinator(router), make_rows(2000)
        for turn, (number, code) in enumerate(
            [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)]
        ):
            with self.process(endpoint, folder.path) as process:
                assert coordinator.open().durable == [500 * turn]
                coordinator.send(rows, 500 * turn, 500 * turn + 500)
                coordinator.hears_durable(500 * turn + 500)
                os.kill(process.pid, number)
                assert process.wait(SOON) == code
        with folder.journal() as journal:
            assert journal.rows(0, 2000).tobytes() == rows[:1500].tobytes()

    def test_a_full_disk_is_waited_for_and_then_ends_it_with_a_sentence(
        self, endpoint: str, router: ZenohBus, folder: RunFolder
    ) -> None:
        coordinator, rows = Coordinator(router), make_rows(12_000)
        with self.process(endpoint, folder.path, "--disk-wait", "3") as process:
            coordinator.open()
            coordinator.send(rows, 0, 1000)
            coordinator.hears_durable(1000)
            room = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (400_000, room[1]))
            for first in range(1000, 6000, 1000):
                coordinator.send(rows, first, first + 1000)
            durable = coordinator.hears(lambda report: bool(report.trouble)).durable
            assert 1000 <= durable < 6000
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, room)
            coordinator.hears_durable(6000)
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (400_000, room[1]))
            for first in range(6000, 12_000, 1000):
                coordinator.send(rows, first, first + 1000)
            durable = coordinator.hears(lambda report: bool(report.trouble)).durable
            _, said = process.communicate(timeout=SOON)
            assert process.returncode == 2
            assert f"`qdgrasp resume {folder.path}` goes on".encode() in said.splitlines()[-1]
        with folder.journal() as journal:
            assert journal.count == durable
            assert journal.rows(0, 4096).tobytes() == rows[: min(durable, 4096)].tobytes()
            assert len(digest(journal)) == 64

    def test_bad_input_is_one_sentence_and_exit_code_2(self, endpoint: str, folder: RunFolder) -> None:
        with self.process(endpoint, folder.path, "--wait", "0.2") as process:
            _, said = process.communicate(timeout=SOON)
        assert process.returncode == 2
        assert said.startswith(f"qdgrasp-recorder: Nothing answers at {endpoint}".encode())

    def test_a_log_on_a_full_disk_changes_nothing(
        self, endpoint: str, router: ZenohBus, folder: RunFolder
    ) -> None:
        coordinator = Coordinator(router)
        with Path("/dev/full").open("wb") as full:
            with self.process(endpoint, folder.path, stderr=full) as process:
                coordinator.open()
                coordinator.send(make_rows(10), 0, 10)
                coordinator.hears_durable(10)
                process.terminate()
                assert process.wait(SOON) == 143
            with folder.job.lock(), self.process(endpoint, folder.path, stderr=full) as process:
                assert process.wait(SOON) == 2

    def test_two_recorders_of_one_folder_are_one_too_many(
        self, endpoint: str, router: ZenohBus, folder: RunFolder
    ) -> None:
        with folder.job.lock(), self.process(endpoint, folder.path) as process:
            _, said = process.communicate(timeout=SOON)
        assert process.returncode == 2
        assert f"is in use by process {os.getpid()}".encode() in said

    def test_a_journal_can_be_read_while_it_is_written(
        self, endpoint: str, router: ZenohBus, folder: RunFolder
    ) -> None:
        coordinator, rows = Coordinator(router), make_rows(1000)
        with self.process(endpoint, folder.path):
            coordinator.open()
            coordinator.send(rows, 0, 1000)
            coordinator.hears_durable(1000)
            with Journal.open(folder.path) as journal:
                assert journal.rows(0, 4096).tobytes() == rows.tobytes()
