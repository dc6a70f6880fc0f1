"""A recorder that keeps several runs of one job."""

from pathlib import Path

import pytest
from tests.common import wait_for
from tests.fakes.recorder import BUNDLE, JOB, SCENE, FakeCoordinator, anonymous, make_rows, recording

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.bus import Query, answer_chunk
from qdgrasp_protocol.errors import DiskFull
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Opened

ROWS = make_rows(3000)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "campaign"


def recorded(path: Path, run: str) -> bytes:
    with RunFolder.open(path / "runs" / run).journal() as journal:
        assert journal.run == run
        return journal.slice(0, 10_000).rows.tobytes()


def send_in_turns(coordinator: FakeCoordinator, runs: str, stop: int, first: int = 0) -> None:
    """Send the rows of each run, a hundred of one, then of the next."""
    for begin in range(first, stop, 100):
        for run in runs:
            coordinator.send(ROWS, begin, begin + 100, run=run)


def test_a_recorder_that_comes_back_in_the_middle_goes_on_with_every_run(network, coordinator, path) -> None:
    with recording(network, path):
        coordinator.open_runs("a", "b")
        send_in_turns(coordinator, "ab", 500)
    with recording(network, path):
        coordinator.meet()
        send_in_turns(coordinator, "ab", 1000, first=500)
        for run in "ab":
            coordinator.hears_durable(1000, run)
        opened = anonymous(coordinator.open_runs("c", "a", epoch=1))
        assert opened == Opened(epoch=1, durable=[0, 1000], platform={"pybullet": "3.2.7"})
    assert recorded(path, "a") == recorded(path, "b") == ROWS[:1000].tobytes()


def test_scenes_that_are_missing_are_fetched_for_all_runs(network, coordinator, path) -> None:
    asked: list[str] = []

    def answer(query: Query) -> bytes:
        if query.key == Keys(JOB).asset(BUNDLE.digest):
            asked.append(query.parameters)
        return answer_chunk(query, SCENE, BUNDLE.digest)

    with network.session() as bus, recording(network, path):
        bus.answer(Keys(JOB).asset(), answer)
        coordinator.open_runs("a", scene="0" * 64)
        coordinator.open_runs("b", "c", epoch=1)
        folders = [RunFolder.open(path / "runs" / run) for run in "bc"]
        wait_for(lambda: all(folder.has_bundle() for folder in folders), "the scene in both folders")
    assert [folder.bundle() for folder in folders] == [BUNDLE, BUNDLE]
    assert len(asked) == len(set(asked)), "the scene was fetched more than once"


class TestFullDisk:
    def test_all_runs_wait_and_say_so_and_go_on_together(self, network, coordinator, path, room) -> None:
        room.set()
        with recording(network, path):
            coordinator.open_runs("a", "b")
            send_in_turns(coordinator, "ab", 1000)
            for run in "ab":
                coordinator.hears_durable(1000, run)
            room.clear()
            send_in_turns(coordinator, "ab", 2000, first=1000)
            for run in "ab":
                report = coordinator.hears(lambda report, run=run: report.run == run and bool(report.trouble))
                assert report.durable == 1000
                assert "no room" in report.trouble
                assert coordinator.page(0, 4096, run).rows.tobytes() == ROWS[:1000].tobytes()
            coordinator.send(ROWS, 1000, 3000, run="b")
            room.set()
            assert not coordinator.hears_durable(2000, "a").trouble
            assert not coordinator.hears_durable(3000, "b").trouble
        assert recorded(path, "a") == ROWS[:2000].tobytes()
        assert recorded(path, "b") == ROWS[:3000].tobytes()

    def test_after_its_patience_the_recorder_ends(self, network, coordinator, path, room) -> None:
        with recording(network, path, disk_wait=0.2) as running:
            coordinator.open_runs("a", "b")
            send_in_turns(coordinator, "ab", 1000)
            running.ends()
            assert isinstance(running.error, DiskFull)
            assert f"`qdgrasp campaign {path}` goes on" in str(running.error)
        assert recorded(path, "a") == recorded(path, "b") == b""
        JobFolder(path).check_not_in_use()
