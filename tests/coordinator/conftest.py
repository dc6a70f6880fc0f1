import threading

import pytest
from tests.coordinator.scenes import SceneMaker, made_scene
from tests.fakes.recorder import FakeCoordinator

from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_protocol.memory_bus import MemoryNetwork


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


@pytest.fixture
def coordinator(network: MemoryNetwork) -> FakeCoordinator:
    return FakeCoordinator(network.session())


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """An event: until it is set, journals have no room to grow."""
    room, append = threading.Event(), JournalWriter.append

    def limited(journal: JournalWriter, part: JournalSlice, epoch: int, now: float) -> None:
        pages = 1_000_000 if room.is_set() else 1
        journal._database.execute(f"PRAGMA max_page_count = {pages}")
        append(journal, part, epoch, now)

    monkeypatch.setattr(JournalWriter, "append", limited)
    monkeypatch.setattr("qdgrasp_coordinator.recorder.recorder.RETRY_INTERVAL", 0.02)
    return room


@pytest.fixture
def make_scene() -> SceneMaker:
    """Makes scenes of the jaw with a given name, and an object with given hulls."""
    return made_scene
