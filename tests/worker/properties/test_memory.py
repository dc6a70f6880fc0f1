"""Memory of a worker's process."""

import pytest
from benchmarks.memory import COURSES, EIGHT, apart, follow, serve, shortened

from qdgrasp_worker.evaluator import MAX_EVALUATORS

GROWTH = 4.0
"""MB that an allocator may still take after warming up."""


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("course", COURSES, ids=lambda course: course.prior)
def test_memory_does_not_grow_with_evaluations(course):
    assert apart(follow, course).growth < GROWTH


@pytest.mark.parametrize("course", COURSES, ids=lambda course: course.prior)
def test_memory_does_not_grow_with_a_few_evaluations_either(course):
    assert apart(follow, shortened(course, 0.02)).growth < GROWTH


@pytest.mark.slow
def test_a_worker_that_keeps_as_many_scenes_as_it_may_stays_under_600_megabytes():
    assert len(EIGHT) == MAX_EVALUATORS
    assert apart(serve).peak < 600
