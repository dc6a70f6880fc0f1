import threading

import pytest
from tests.coordinator.recording.recorded import Coordinator
from tests.coordinator.scenes import SceneMaker, made_scene

from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.journal_writer import JournalWriter
from qdgrasp_protocol.local_bus import LocalNetwork


@pytest.fixture
def network() -> LocalNetwork:
    return LocalNetwork()


@pytest.fixture
def coordinator(network: LocalNetwork) -> Coordinator:
    return Coordinator(network.session())


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """While it is not set, journals may not grow."""
    room, append = threading.Event(), JournalWriter.append

    def limited(journal: JournalWriter, stretch: Stretch, epoch: int, now: float) -> None:
        pages = 1_000_000 if room.is_set() else 1
        journal._database.execute(f"PRAGMA max_page_count = {pages}")
        append(journal, stretch, epoch, now)

    monkeypatch.setattr(JournalWriter, "append", limited)
    monkeypatch.setattr("qdgrasp_coordinator.recording.room.RETRY_INTERVAL", 0.02)
    return room


@pytest.fixture
def make_scene() -> SceneMaker:
    """A scene of the jaw, called what is asked for, and an object with these hulls in its mesh frame."""
    return made_scene
