"""What a recorder shows to those who watch."""

import socket
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import asdict
from tests.coordinator.recording.recorded import BUNDLE, JOB, SCENE, SPEC, Coordinator, make_rows, recording

from qdgrasp_coordinator.counts import finds
from qdgrasp_coordinator.counts.entry import RunEntries
from qdgrasp_coordinator.counts.figures import from_json
from qdgrasp_coordinator.counts.tally import successful
from qdgrasp_coordinator.folders import journal_finds
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.recording import register
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.local_bus import LocalNetwork
from qdgrasp_protocol.messages import Finds

KEYS = Keys(JOB)
ROWS = make_rows(400)
FOUND = np.flatnonzero(successful(ROWS))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "job"


def entries(network: LocalNetwork) -> RunEntries:
    with network.session() as bus:
        return from_json(bus.ask(KEYS.entries), RunEntries)


def all_finds(network: LocalNetwork, run: str = "run") -> tuple[list[int], int]:
    """The numbers of all finds, and in how many answers they came."""
    numbers: list[int] = []
    first = answers = 0
    with network.session() as bus:
        while True:
            answer = codec.decode(bus.ask(KEYS.finds, parameters=f"run={run}&from={first}"), Finds)
            answers += 1
            numbers += finds.from_message(answer)["number"].tolist()
            if answer.next >= answer.rows:
                return numbers, answers
            assert answer.next > first
            first = answer.next


def test_every_success_is_shown_once_and_by_its_number(
    network: LocalNetwork, coordinator: Coordinator, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_finds, "SCANNED", 70)
    with recording(network, path):
        coordinator.open()
        assert all_finds(network) == ([], 1)
        coordinator.send(ROWS, 0, 400)
        coordinator.hears_durable(400)
        assert all_finds(network) == (FOUND.tolist(), 6)


def test_a_page_has_no_more_finds_than_an_answer_may_have(
    network: LocalNetwork, coordinator: Coordinator, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finds, "MOST", 7)
    with recording(network, path):
        coordinator.open()
        coordinator.send(ROWS, 0, 400)
        coordinator.hears_durable(400)
        numbers, answers = all_finds(network)
    assert numbers == FOUND.tolist()
    assert answers == len(FOUND) // 7 + 1


def test_finds_hold_what_the_journal_holds(
    network: LocalNetwork, coordinator: Coordinator, path: Path
) -> None:
    with recording(network, path):
        coordinator.open()
        coordinator.send(ROWS, 0, 400)
        coordinator.hears_durable(400)
        with network.session() as bus:
            answer = codec.decode(bus.ask(KEYS.finds, parameters="run=run;from=0"), Finds)
    shown = finds.from_message(answer)
    for column in ("outcome", "fitness", "descriptor", "base_to_object", "joints"):
        assert np.array_equal(shown[column], ROWS[column][FOUND])


def test_entries_count_what_is_recorded_of_each_run(
    network: LocalNetwork, coordinator: Coordinator, path: Path
) -> None:
    with recording(network, path):
        coordinator.open_runs("a", "b")
        coordinator.send(ROWS, 0, 300, run="a")
        coordinator.hears_durable(300, "a")
        one, other = entries(network).runs
        assert (one.run, one.rows, other.run, other.rows) == ("a", 300, "b", 0)
        assert one.scene == BUNDLE.digest
        assert sum(one.outcomes.values()) == one.evaluations == 300
        assert one.successes == int(successful(ROWS[:300]).sum())
        coordinator.send(ROWS, 300, 400, run="a")
        coordinator.hears_durable(400, "a")
        later = entries(network).runs[0]
    with RunFolder(path / "runs" / "a").journal() as journal:
        counted = register.Register(path).page(0).runs[0]
        assert (journal.count, later.rows) == (400, 400)
    assert asdict(later) == asdict(counted)


def test_it_is_told_where_runs_lie(network: LocalNetwork, coordinator: Coordinator, path: Path) -> None:
    with recording(network, path):
        coordinator.open_runs("a", "b")
        told = entries(network)
    assert told.host == socket.gethostname()
    assert [Path(run.folder) for run in told.runs] == [path / "runs" / "a", path / "runs" / "b"]


def test_runs_are_counted_a_few_rows_at_a_time_and_left_out_until_they_are(
    network: LocalNetwork, coordinator: Coordinator, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(register, "ROWS", 150)
    with recording(network, path):
        coordinator.open_runs("a", "b")
        for run in ("a", "b"):
            coordinator.send(ROWS, 0, 200, run=run)
            coordinator.hears_durable(200, run)
        told = [entries(network) for _ in range(3)]
    assert [(len(one.runs), one.uncounted) for one in told] == [(0, 2), (1, 1), (2, 0)]
    assert [run.rows for run in told[-1].runs] == [200, 200]


def test_many_runs_come_in_pages(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(register, "PAGE", 2)
    network = LocalNetwork()
    coordinator = Coordinator(network.session())
    with recording(network, path):
        coordinator.open_runs("a", "b", "c")
        with network.session() as bus:
            pages = [from_json(bus.ask(KEYS.entries, parameters=f"from={n}"), RunEntries) for n in (0, 2)]
    assert [([run.run for run in page.runs], page.next) for page in pages] == [(["a", "b"], 2), (["c"], 0)]


def test_a_scene_is_shown_from_the_folder_of_its_run(
    network: LocalNetwork, coordinator: Coordinator, path: Path
) -> None:
    RunFolder.create(path, SPEC, BUNDLE, job=JOB)
    with recording(network, path), network.session() as bus:
        coordinator.open()
        assert chunks.gather(bus, KEYS.recorded_asset(BUNDLE.digest), BUNDLE.digest) == SCENE
        with pytest.raises(Refused, match="no run here has the scene 000000000000"):
            bus.ask(KEYS.recorded_asset("0" * 64), parameters="i=0")


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ("run=other&from=0", "no run 'other'"),
        ("run=../job&from=0", "no run '../job'"),
        ("", "no run ''"),
        ("run=run&from=-1", "'-1' is no number: from"),
        ("run=run&from=1e3", "'1e3' is no number: from"),
    ],
)
def test_what_cannot_be_shown_is_refused_with_the_reason(
    network: LocalNetwork, coordinator: Coordinator, path: Path, parameters: str, reason: str
) -> None:
    with recording(network, path), network.session() as bus:
        coordinator.open()
        with pytest.raises(Refused, match=reason):
            bus.ask(KEYS.finds, parameters=parameters)


def test_before_a_run_is_opened_there_is_nothing_to_show(
    network: LocalNetwork, coordinator: Coordinator, path: Path
) -> None:
    with recording(network, path):
        coordinator.meet()
        assert entries(network).runs == []
        with pytest.raises(Refused, match="no run 'run'"):
            all_finds(network)
