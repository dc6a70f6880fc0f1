"""Memory of a worker's process."""

import pytest
from benchmarks.memory import EIGHT_SCENES, SERIES, in_new_process, measure_memory, measure_scenes, shortened

from qdgrasp_worker.evaluator import MAX_EVALUATORS

GROWTH = 4.0
"""MB that an allocator may still take after warming up."""


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("series", SERIES, ids=lambda series: series.prior)
def test_memory_does_not_grow_with_evaluations(series):
    assert in_new_process(measure_memory, series).growth < GROWTH


@pytest.mark.parametrize("series", SERIES, ids=lambda series: series.prior)
def test_memory_does_not_grow_with_a_few_evaluations_either(series):
    assert in_new_process(measure_memory, shortened(series, 0.02)).growth < GROWTH


@pytest.mark.slow
def test_a_worker_that_keeps_as_many_scenes_as_it_may_stays_under_600_megabytes():
    assert len(EIGHT_SCENES) == MAX_EVALUATORS
    assert in_new_process(measure_scenes).peak < 600
