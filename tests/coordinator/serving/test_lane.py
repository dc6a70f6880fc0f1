"""A run that is opened: what is recorded is replayed, and what its spec does not allow is refused."""

from collections.abc import Callable

import numpy as np
import pytest
from tests.coordinator.runs.plans import SHAPE, Plan, reference
from tests.coordinator.serving.served import assignment

from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.messages import Opened, OpenRun
from qdgrasp_protocol.rows import Rows

PLAN = Plan(population=10, evaluations=40)
ROWS = np.frombuffer(reference(PLAN), SHAPE.dtype)


class Recorded(Memory):
    """A record that holds rows from before, in pages."""

    def __init__(self, rows: Rows, page: int) -> None:
        super().__init__(SHAPE)
        self._before = rows
        self._page = page

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        return Opened(epoch=1, durable=[len(self._before)], platform={})

    def recorded(self, first: int, wait: Callable[[], None]) -> Stretch:
        return Stretch(first, self._before[first : first + self._page])


def opened(plan: Plan, rows: Rows, page: int) -> Lane:
    lane = Lane(assignment("run", plan), Recorded(rows, page))
    lane.open(0, lambda: None)
    return lane


@pytest.mark.parametrize("page", [1, 7, 1000])
def test_a_run_goes_on_where_its_records_end(page: int) -> None:
    assert opened(PLAN, ROWS[:23], page).tally.rows == 23
    assert opened(PLAN, ROWS, page).is_done


@pytest.mark.parametrize("page", [1, 10, 20, 40, 1000])
def test_records_that_go_on_behind_the_end_of_the_run_are_refused_wherever_pages_end(page: int) -> None:
    sooner = Plan(population=10, evaluations=20)
    with pytest.raises(ReplayError, match=r"goes on after its row .* budget of 20 evaluations is spent"):
        opened(sooner, ROWS, page)
