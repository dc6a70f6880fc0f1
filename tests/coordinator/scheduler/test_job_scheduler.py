"""When a job ends before it is done."""

from math import inf

import pytest

from qdgrasp_coordinator.scheduler.job_scheduler import LEAST_STOP_SECONDS, MOST_STOP_SECONDS, EarlyStop
from qdgrasp_protocol.errors import Cancelled


def test_a_job_ends_by_itself_when_its_time_is_over_and_not_before() -> None:
    ending = EarlyStop(10.0, now=100.0)
    assert (ending.is_due(109.9), ending.is_due(110.0)) == (False, True)
    assert ending.deadline == 110.0
    assert not ending.is_over(1e9, is_safe=True)


def test_a_job_without_a_limit_never_does() -> None:
    ending = EarlyStop(None, now=0.0)
    assert (ending.is_due(1e9), ending.deadline) == (False, inf)


@pytest.mark.parametrize(("is_safe", "patience"), [(True, LEAST_STOP_SECONDS), (False, MOST_STOP_SECONDS)])
def test_an_ending_waits_for_the_recorder_but_not_for_ever(is_safe: bool, patience: float) -> None:
    ending = EarlyStop(10.0, now=0.0)
    ending.begin(5.0, cancelled := Cancelled("mugs"))
    assert ending.reason is cancelled
    assert not ending.is_due(11.0)
    assert ending.deadline == inf
    assert not ending.is_over(4.99 + patience, is_safe=is_safe)
    assert ending.is_over(5.0 + patience, is_safe=is_safe)
