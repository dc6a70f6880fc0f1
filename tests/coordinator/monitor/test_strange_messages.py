"""What a monitor makes of messages that are none, or of another version."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.monitor.heard import MUGS, START, seen, watching
from tests.coordinator.monitor.shown import figures, values

from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.monitor.jobs import Jobs

PLACES = (
    "meta",
    "stat/job",
    "stat/run/a",
    "stat/team/0",
    "stat/curve/a",
    "event/job",
    "event/recent",
    "x",
    "",
)


@given(st.binary(max_size=200), st.sampled_from(PLACES))
def test_what_is_no_message_changes_nothing(payload: bytes, place: str) -> None:
    jobs = watching()
    before = seen(jobs, START)
    jobs.heard(f"{MUGS.root}/{place}", payload, START)
    assert seen(jobs, START) == before


@pytest.mark.parametrize(
    "key", ["", "else/where", "qdgrasp/v1/BAD NAME/stat/job", "qdgrasp/v2/mugs/stat/job"]
)
def test_keys_of_others_are_left_alone(key: str) -> None:
    jobs = Jobs()
    jobs.heard(key, to_json(figures()), START)
    jobs.token(key, True, START)
    assert (jobs.views(START), jobs.strangers) == ([], [])


def test_a_job_of_another_version_is_named_until_it_can_be_read() -> None:
    jobs = Jobs()
    jobs.heard(MUGS.stat("job"), b'{"job": "mugs", "figures": "quite other ones"}', START)
    assert (jobs.views(START), jobs.strangers) == ([], ["mugs"])
    jobs.answered(values(), START)
    assert (len(jobs.views(START)), jobs.strangers) == (1, [])


def test_fields_that_a_later_version_adds_are_passed_over() -> None:
    jobs = watching()
    later = to_json(figures(evaluations=2000)).replace(b'{"job"', b'{"mood": "good", "job"', 1)
    jobs.heard(MUGS.stat("job"), later, START)
    assert seen(jobs, START).figures.evaluations == 2000
