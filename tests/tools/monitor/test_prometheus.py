"""Metrics of a monitor for Prometheus."""

import pytest
from msgspec import structs
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families
from tests.tools.monitor.sample_jobs import event, run, values, views, worker

from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.job_model import MOST_WORKERS, JobView
from qdgrasp_tools.monitor.prometheus import STATES, exposition

OUTCOMES = {one.name.lower(): int(one) for one in Outcome}


@pytest.fixture
def job() -> JobView:
    (view,) = views(values())
    return structs.replace(view, events=[event(1), event(7)], runs=[run("a", outcomes=OUTCOMES), run("b")])


def text(*jobs: JobView) -> str:
    return exposition(jobs)[0].decode()


def read(text: str) -> dict[str, Metric]:
    """The metrics by their names, as prometheus_client's own parser reads them."""
    found = list(text_string_to_metric_families(text))
    assert len({one.name for one in found}) == len(found)
    return {one.name: one for one in found}


def samples(text: str) -> dict[tuple[str, ...], float]:
    """Return samples by the metric's name and the values of its labels, in their order."""
    found = [sample for one in read(text).values() for sample in one.samples]
    told = {(one.name, *(one.labels[label] for label in sorted(one.labels))): one.value for one in found}
    assert len(told) == len(found)
    return told


def test_what_is_told_is_what_the_figures_say(job: JobView) -> None:
    told = samples(text(job))
    figures = {"up": 1, "job_evaluations_total": 1000, "job_budget_evaluations": 3000, "job_cells": 5}
    figures |= {"job_events_total": 7, "job_start_time_seconds": job.meta.since.timestamp()}
    assert {name: told[f"qdgrasp_{name}", "mugs"] for name in figures} == figures
    assert told["qdgrasp_run_evaluations_total", "mugs", "b"] == 10
    assert told["qdgrasp_job_info", "head", "mugs", "0"] == 1
    assert told["qdgrasp_run_info", "panda", "mugs", "portfolio", "mug", "paper", "a", "0"] == 1


def test_of_all_states_a_job_is_in_one(job: JobView) -> None:
    for state in STATES:
        told = samples(text(structs.replace(job, state=state)))
        held = {key[-1]: value for key, value in told.items() if key[0] == "qdgrasp_job_state"}
        assert held == {each: float(each == state) for each in STATES}


def test_the_number_of_series_is_bounded_and_all_workers_are_counted(job: JobView) -> None:
    many = [worker(number) for number in range(2 * MOST_WORKERS)]
    told = samples(text(structs.replace(job, workers=many)))
    assert sum(key[0] == "qdgrasp_worker_rows_total" for key in told) == MOST_WORKERS
    assert sum(value for key, value in told.items() if key[0] == "qdgrasp_workers") == len(many)


@pytest.mark.parametrize("state", ["silent", "gone", "ended", "cancelled"])
def test_of_a_job_that_nobody_speaks_for_only_counts_are_left(job: JobView, state: str) -> None:
    told = samples(text(structs.replace(job, state=state)))
    assert told["qdgrasp_up", "mugs"] == 0
    assert told["qdgrasp_job_evaluations_total", "mugs"] == 1000
    names = {key[0] for key in told}
    assert names.isdisjoint({"qdgrasp_workers", "qdgrasp_worker_rows_total", "qdgrasp_job_workers"})
