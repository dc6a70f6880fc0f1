"""What is known of a job's workers."""

from concurrent.futures import Future

import msgspec
import pytest
from tests.coordinator.recording.recorded import JOB

from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.team import PAGE, TeamFigures, WorkerFigures
from qdgrasp_coordinator.serving.chronicle import Chronicle
from qdgrasp_coordinator.serving.inbox import JoinRequest, TokenChange
from qdgrasp_coordinator.serving.team import MOST_GONE, SHOWN_GONE, Team
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Join
from qdgrasp_protocol.sign import Sign

ANN, BOB = "a" * 32, "b" * 32
KEYS = Keys(JOB)


def join(wid: str, number: int = 1, credit: int = 2) -> Join:
    platform = {"pybullet": "3.2.7"}
    return Join(
        versions=[1], wid=wid, number=number, credit=credit, held=[], host="node7", pid=9, platform=platform
    )


class Office:
    """A turn without runs, and what it notes."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.turn = Turn(JOB, 1, self, lambda *_: None, None, Chronicle(self.events.append))  # type: ignore[arg-type]

    def __iter__(self):  # type: ignore[no-untyped-def]
        return iter(())

    def get(self, run: str) -> None:
        return None

    def joins(self, asked: Join, now: float) -> "Future[bytes]":
        request = JoinRequest(asked)
        self.turn.take(TokenChange(KEYS.worker_token(asked.wid), True), now)
        self.turn.take(request, now)
        return request.answer

    def dies(self, wid: str, now: float) -> None:
        self.turn.take(TokenChange(KEYS.worker_token(wid), False), now)

    def says(self, now: float, wid: str = ANN, **values: object) -> None:
        sign = Sign(wid=wid, host="node7", **values)  # type: ignore[arg-type]
        key = KEYS.stat(f"worker/{wid}")
        self.turn.take(Sample(key, msgspec.json.encode(sign), "application/json"), now)

    def shown(self, now: float) -> list[WorkerFigures]:
        return [worker for page in self.turn.crew.pages(now) for worker in page.workers]

    def states(self, now: float) -> list[str]:
        return [worker.state for worker in self.shown(now)]

    @property
    def words(self) -> list[str]:
        return [event.words for event in self.events]


@pytest.fixture
def office() -> Office:
    return Office()


def test_what_a_worker_says_of_itself_is_shown(office: Office) -> None:
    office.joins(join(ANN), 10.0)
    office.says(12.0, memory=1 << 30, restarts=2)
    (ann,) = office.shown(15.0)
    assert (ann.memory, ann.restarts, ann.host, ann.pid) == (1 << 30, 2, "node7", 9)
    assert (ann.seconds, ann.seen) == (5.0, 3.0)


def test_a_killed_worker_is_gone_at_once_and_stays_on_the_list_for_a_minute(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    office.joins(join(BOB), 0.0)
    office.dies(ANN, 5.0)
    assert office.states(5.0) == ["gone", "idle"]
    office.turn.step(6.1)
    assert office.words[-1] == "Worker aaaaaaaa on node7 (process 9) is gone: its token vanished."
    assert office.states(6.1 + SHOWN_GONE - 0.1) == ["idle", "gone"]
    assert office.states(6.2 + SHOWN_GONE) == ["idle"]


def test_a_worker_whose_token_is_late_is_not_shown_as_gone(office: Office) -> None:
    office.turn.take(JoinRequest(join(ANN)), 0.0)
    assert office.states(1.0) == ["idle"]
    office.turn.take(TokenChange(KEYS.worker_token(ANN), True), 2.0)
    office.dies(ANN, 3.0)
    assert office.states(3.0) == ["gone"]


def test_a_worker_that_said_it_leaves_has_left(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    office.joins(join(ANN, number=2, credit=0), 1.0)
    office.dies(ANN, 2.0)
    office.turn.step(4.0)
    assert [words.split(")")[1] for words in office.words] == [" joined.", " has left."]


def test_a_worker_that_joins_again_goes_on_as_it_was(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    office.dies(ANN, 5.0)
    office.turn.step(7.0)
    office.joins(join(ANN, number=2), 20.0)
    (ann,) = office.shown(30.0)
    assert (ann.state, ann.seconds) == ("idle", 30.0)


def test_a_refused_worker_is_told_of_with_the_reason(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    other = msgspec.structs.replace(join(BOB), platform={"pybullet": "9"})
    assert office.joins(other, 1.0).exception()
    (_, refused) = office.events
    assert (refused.kind, refused.worker) == ("worker", BOB)
    assert "was refused" in refused.words
    assert "pybullet" in refused.words


def test_a_sign_without_progress_keeps_nobody_from_being_stuck(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    member = office.turn.dispatch.members[0]
    office.says(5.0, progressed=False)
    assert (member.progress, office.shown(5.0)[0].seen) == (0.0, 0.0)
    office.says(6.0, progressed=True)
    assert member.progress == 6.0


@pytest.mark.parametrize("workers", [0, 1, PAGE, PAGE + 1])
def test_each_worker_stands_on_one_page(office: Office, workers: int) -> None:
    for number in range(workers):
        office.joins(join(f"{number:032x}"), 0.0)
    pages: list[TeamFigures] = office.turn.crew.pages(1.0)
    assert [page.page for page in pages] == list(range(max(1, -(-workers // PAGE))))
    assert {page.pages for page in pages} == {len(pages)}
    assert [int(worker.wid, 16) for page in pages for worker in page.workers] == list(range(workers))


def test_no_more_of_those_who_are_gone_are_kept_than_can_be_shown() -> None:
    team = Team()
    for number in range(2 * MOST_GONE):
        team.joined(join(f"{number:032x}"), 0.0)
        team.lost(f"{number:032x}", 0.0)
    assert sum(len(page.workers) for page in team.pages([], 1.0)) == MOST_GONE
