"""Runs of a job are opened, replayed, put back and removed."""

from collections.abc import Callable
from queue import SimpleQueue

import numpy as np
import pytest
from tests.common import PATIENCE
from tests.coordinator.scheduler.search_plans import SHAPE, Plan, reference
from tests.fakes.job import FakeRunQueue, OpenedSink, make_run_plan, runs_of

from qdgrasp_coordinator.scheduler import run_registry
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun, LoadEnded, LoaderEvent
from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_protocol.errors import ReplayError, RunFailed
from qdgrasp_protocol.messages import Opened
from qdgrasp_protocol.rows import Rows

PLAN = Plan(population=10, evaluations=40)
ROWS = np.frombuffer(reference(PLAN), SHAPE.dtype)


class Recorded(OpenedSink):
    """A record that holds rows from before, in pages."""

    def __init__(self, rows: Rows, page: int) -> None:
        super().__init__(SHAPE)
        self._before = rows
        self._page = page
        self.answer = Opened(epoch=1, durable=[len(rows)], platform={})

    def recorded_rows(self, first: int, wait: Callable[[], None]) -> JournalSlice:
        return JournalSlice(first, self._before[first : first + self._page])


def opened(plan: Plan, rows: Rows, page: int) -> ActiveRun:
    run = ActiveRun(make_run_plan("run", plan), Recorded(rows, page))
    run.open(0, lambda: None)
    return run


@pytest.mark.parametrize("page", [1, 7, 1000])
def test_a_run_goes_on_where_its_records_end(page: int) -> None:
    assert opened(PLAN, ROWS[:23], page).tally.rows == 23
    assert opened(PLAN, ROWS, page).is_done


@pytest.mark.parametrize("page", [1, 10, 20, 40, 1000])
def test_records_that_go_on_behind_the_end_of_the_run_are_refused_wherever_pages_end(page: int) -> None:
    sooner = Plan(population=10, evaluations=20)
    with pytest.raises(ReplayError, match=r"goes on after its row .* budget of 20 evaluations is spent"):
        opened(sooner, ROWS, page)


class Coming:
    """Lanes whose news is heard when a test wants to."""

    def __init__(self, *runs: str) -> None:
        self._news: SimpleQueue[LoaderEvent] = SimpleQueue()
        self.runs = runs_of(FakeRunQueue({name: Plan(evaluations=40) for name in runs}), self._news.put)

    def ask(self):
        """Have another run opened; gives the loader's event, which the runs have not heard."""
        self.runs.load(1, workers=1, is_wanted=True)
        return self._news.get(timeout=PATIENCE)

    def open(self) -> ActiveRun:
        """Open the next run."""
        self.hear(event := self.ask())
        return event.run

    def hear(self, event: LoadEnded) -> None:
        """Have the runs take what the loader says."""
        self.runs.load_ended(event)
        if event.run is not None:
            self.runs.add(event.run)


@pytest.mark.parametrize("others", [(), ("other",)])
def test_a_run_that_is_put_back_while_none_was_left_is_opened_again(others: tuple[str, ...]) -> None:
    coming = Coming("run", *others)
    run, *rest = (coming.open() for _ in ("run", *others))
    last = coming.ask()
    assert last == LoadEnded(is_last=True)
    coming.runs.reopen(run)  # before that is heard
    coming.hear(last)
    for one in rest:
        coming.runs.remove(one)
    assert not coming.runs.are_done
    again = coming.open()
    assert again.name == "run"
    coming.hear(coming.ask())
    coming.runs.remove(again)
    assert coming.runs.are_done


def test_what_remains_is_of_runs_that_are_not_over() -> None:
    coming = Coming("run", "other", "third")

    def remaining() -> int:
        return coming.runs.status(0.0, job="job", workers=1).remaining

    assert remaining() == 3 * 40
    run, other = coming.open(), coming.open()
    run.tally.evaluations = 15
    assert remaining() == 105
    run.tally.finished = "it found enough"
    assert remaining() == 80
    coming.runs.remove(run)
    assert remaining() == 80
    coming.runs.add_failure(RunFailed("third", "Its mesh is no mesh."))
    assert remaining() == 40
    coming.runs.reopen(other)
    assert remaining() == 40


def test_as_many_runs_are_open_at_once_as_there_are_workers_between_two_bounds(monkeypatch) -> None:
    monkeypatch.setattr(run_registry, "MOST_RUNS", 1)
    monkeypatch.setattr(run_registry, "MOST_RUNS_OF_MANY", 3)
    coming = Coming("a", "b", "c", "d")
    for workers, most in ((0, 1), (1, 1), (2, 2), (9, 3)):
        for _ in range(4):
            coming.runs.load(1, is_wanted=True, workers=workers)
            if coming.runs.is_loading:
                coming.hear(coming._news.get(timeout=PATIENCE))
        assert len(list(coming.runs)) == most
