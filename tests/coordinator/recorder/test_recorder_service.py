import threading
from pathlib import Path

import pytest
from tests.common import PATIENCE, wait_for
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.recorder import BUNDLE, JOB, SCENE, SHAPE, SPEC, FakeCoordinator, make_rows, recording

from qdgrasp_coordinator.recorder import recorder_service
from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.storage.journal import JournalSlice, slice_to_message
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, answer_chunk, fetch_bundle
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Failure, Recordable
from qdgrasp_protocol.rows import RowShape


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "run", SPEC, BUNDLE, job=JOB)


def show_scene(bus: Bus) -> None:
    """Answer queries for the scene, as the coordinator does."""
    bus.answer(Keys(JOB).asset(), lambda query: answer_chunk(query, SCENE, BUNDLE.digest))


class TestOpening:
    def test_a_coordinator_that_is_slow_to_show_its_scene_keeps_no_row_waiting_and_no_recorder_from_ending(
        self,
        network: MemoryNetwork,
        coordinator: FakeCoordinator,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        asked, may_answer, fetch = threading.Event(), threading.Event(), fetch_bundle

        def slow(*question: object) -> bytes:
            asked.set()
            assert may_answer.wait(2 * PATIENCE)
            return fetch(*question)  # type: ignore[arg-type]

        monkeypatch.setattr(recorder_service, "fetch_bundle", slow)
        with network.session() as bus:
            show_scene(bus)
            with recording(network, tmp_path / "new"):
                coordinator.open()
                assert asked.wait(PATIENCE)
                coordinator.send(make_rows(30), 0, 30)
                coordinator.hears_durable(30)
            folder = RunFolder.open(tmp_path / "new")
            assert not folder.has_bundle()
            with recording(network, tmp_path / "new"):
                may_answer.set()
                wait_for(folder.has_bundle)


class TestRecording:
    def test_lost_repeated_and_overlapping_messages_leave_each_row_once(self, network, coordinator, folder):
        rows = make_rows(100)
        with recording(network, folder.path):
            coordinator.open()
            coordinator.send(rows, 50, 100)
            coordinator.hears_durable(0)
            for first, stop in ((0, 30), (0, 30), (20, 60), (10, 20), (40, 100), (0, 100)):
                coordinator.send(rows, first, stop)
            coordinator.hears_durable(100)
        with folder.journal() as journal:
            assert journal.slice(0, 1000).rows.tobytes() == rows.tobytes()

    def test_what_is_not_of_the_protocol_is_dropped(self, network, coordinator, folder) -> None:
        rows = make_rows(10)
        wide = RowShape(genes=8, joints=2)
        with network.session() as bus, recording(network, folder.path):
            coordinator.open()
            for payload, kind in ((b"\x90" * 1000, Recordable), (b"", Recordable), (b"\xc1", Recordable)):
                bus.put(Keys(JOB).outcome(1), payload, encoding=messages.encoding(kind))
            bus.put(Keys(JOB).outcome(1), b"text", encoding="text/plain")
            coordinator.put(slice_to_message(JournalSlice(0, wide.empty(3)), "run", 1, wide))
            coordinator.send(rows, 0, 3, failures=(Failure(row=3, reason="behind the end"),))
            coordinator.send(rows, 0, 10)
            coordinator.hears_durable(10)

    def test_the_platform_reaches_a_recorder_that_was_away_when_it_became_known(self, network, folder):
        link, run = RecorderClient(network.session(), JOB, SHAPE), FakeCoordinator(network.session())
        with recording(network, folder.path):
            run.meet()
            link.open(run.question(), 0, lambda: None)
        link.platform = {"pybullet": "3.2.7"}
        link.push(JournalSlice(0, make_rows(10)))
        link.tick(0.0)
        with recording(network, folder.path):
            run.meet()
            link.resend(0.1)
            link.tick(0.2)
            run.hears(lambda report: report.durable == 10)
        with folder.journal() as journal:
            assert journal.platform == {"pybullet": "3.2.7"}


class TestFolders:
    def test_a_folder_in_use_another_jobs_or_with_other_files_ends_the_recorder(
        self, network: MemoryNetwork, coordinator: FakeCoordinator, folder: RunFolder, tmp_path: Path
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
