"""Runs that come and go while the opener looks for another one."""

from queue import SimpleQueue

import pytest
from tests.coordinator.runs.plans import Plan
from tests.coordinator.serving.served import Runs
from tests.patience import PATIENCE

from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.lanes import Lanes
from qdgrasp_coordinator.serving.opener import Begun, News, NoneLeft
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_protocol.errors import RunFailed
from qdgrasp_protocol.lifetime import Stop


class Coming:
    """Lanes whose news is heard when a test wants to."""

    def __init__(self, *runs: str) -> None:
        self._news: SimpleQueue[News] = SimpleQueue()
        programme = Runs({name: Plan(evaluations=40) for name in runs})
        self.lanes = Lanes(programme, lambda run: Memory(run.shape), self._news.put, Stop())

    def ask(self) -> News:
        """Have another run opened; gives what comes of it, which the lanes have not heard."""
        self.lanes.open_another(1, is_wanted=True)
        return self._news.get(timeout=PATIENCE)

    def open(self) -> Lane:
        """Open the next run."""
        news = self.ask()
        assert isinstance(news, Begun)
        self.lanes.begin(news.lane)
        return news.lane


@pytest.mark.parametrize("others", [(), ("other",)])
def test_a_run_that_is_put_back_while_none_was_left_is_opened_again(others: tuple[str, ...]) -> None:
    coming = Coming("run", *others)
    lane, *rest = (coming.open() for _ in ("run", *others))
    assert coming.ask() == NoneLeft()
    coming.lanes.reopen(lane)  # before that is heard
    coming.lanes.none_left()
    for one in rest:
        coming.lanes.end(one)
    assert not coming.lanes.are_done
    again = coming.open()
    assert again.run == "run"
    assert coming.ask() == NoneLeft()
    coming.lanes.none_left()
    coming.lanes.end(again)
    assert coming.lanes.are_done


def test_what_remains_is_of_runs_that_are_not_over() -> None:
    coming = Coming("run", "other", "third")

    def remaining() -> int:
        return coming.lanes.figures("job", 1, 0.0).remaining

    assert remaining() == 3 * 40
    lane, other = coming.open(), coming.open()
    lane.tally.evaluations = 15
    assert remaining() == 105
    lane.tally.finished = "it found enough"
    assert remaining() == 80
    coming.lanes.end(lane)
    assert remaining() == 80
    coming.lanes.fail(RunFailed("third", "Its mesh is no mesh."))
    assert remaining() == 40
    coming.lanes.reopen(other)
    assert remaining() == 40


def test_a_run_that_is_put_back_is_opened_once() -> None:
    coming = Coming("run", "other")
    lane = coming.open()
    coming.lanes.reopen(lane)
    assert [coming.open().run for _ in range(2)] == ["run", "other"]
    assert coming.ask() == NoneLeft()
