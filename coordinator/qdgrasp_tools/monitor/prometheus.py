"""Metrics of jobs for Prometheus, named and typed by its conventions.

Metrics of a job begin with `qdgrasp_job_`, those of a run with `qdgrasp_run_`, those of a worker with
`qdgrasp_worker_`, so that parts are not added to their sum. A figure that only grows is a counter and ends in
`_total`; a unit stands before that. Texts from elsewhere are labels' values, never names. The help of a
metric is the docstring of its figure (`metrics.job_status`).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeAlias

from msgspec import Struct
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from qdgrasp_coordinator.metrics.job_status import (
    JobEvent,
    JobMeta,
    JobStatus,
    RunStatus,
    WorkerStatus,
    meanings,
)
from qdgrasp_tools.monitor.job_model import MOST_WORKERS, OVER, JobView

INACTIVE_STATES = ("silent", *OVER)  # The states of a job without messages
STATES = ("starting", "running", "paused", "ending", *INACTIVE_STATES)  # States of a job: see `JobView`
RUN_LABELS = ("gripper", "object", "method", "protocol", "seed")  # Labels of `qdgrasp_run_info`
COUNTER, GAUGE = CounterMetricFamily, GaugeMetricFamily

Family: TypeAlias = type[CounterMetricFamily] | type[GaugeMetricFamily]
Samples: TypeAlias = Iterable[tuple[Sequence[str], float]]  # Values of a metric's labels, and its own
MetricSpec: TypeAlias = tuple[str, Family, str, str]
"""A figure that is a metric: its field, its family, its name where that is not the field's, and its unit."""


def counters(*fields: str) -> tuple[MetricSpec, ...]:
    """Return the specs of figures that only grow."""
    return tuple((field, COUNTER, "", "") for field in fields)


COUNT_METRICS: tuple[MetricSpec, ...] = (
    *counters("evaluations", "trials", "simulated", "steps", "overlaps", "dead_ends"),
    *counters("successes", "grasps", "robust", "errors"),
    ("cells", GAUGE, "", ""),
    ("contact_niches", GAUGE, "", ""),
    ("budget", GAUGE, "", "evaluations"),
)
"""Metrics of both jobs and runs."""
JOB_METRICS: tuple[MetricSpec, ...] = (
    *COUNT_METRICS,
    ("remaining", GAUGE, "", "evaluations"),
    ("scenes_seconds", COUNTER, "scenes_cpu_seconds", ""),
)
COORDINATED_METRICS: tuple[MetricSpec, ...] = (
    ("requeued", COUNTER, "requeued_batches", ""),
    ("doubled", COUNTER, "doubled_batches", ""),
    ("strays", COUNTER, "stray_results", ""),
    ("waiting", GAUGE, "", "rows"),
    ("workers", GAUGE, "", ""),
    ("wanted_workers", GAUGE, "", ""),
    ("recorders", GAUGE, "", ""),
)
"""Metrics of a job while its coordinator publishes."""
RUN_METRICS: tuple[MetricSpec, ...] = (
    *counters("rows"),
    ("durable", GAUGE, "", "rows"),
    *COUNT_METRICS,
)
WORKER_METRICS: tuple[MetricSpec, ...] = (
    *counters("rows"),
    ("batches", GAUGE, "", ""),
    ("memory", GAUGE, "", "bytes"),
    ("seen", GAUGE, "silent", "seconds"),
    ("restarts", COUNTER, "simulator_restarts", ""),
)
JOB_GAUGES: tuple[tuple[str, str, Callable[[JobView], float], str], ...] = (
    ("job_epoch", meanings(JobMeta)["epoch"], lambda view: view.meta.epoch, ""),
    ("job_start_time", meanings(JobMeta)["since"], lambda view: view.meta.since.timestamp(), "seconds"),
    ("up", "Whether the job's coordinator is heard.", lambda view: view.state not in INACTIVE_STATES, ""),
    ("job_trouble", "Whether something keeps the job from going on.",
     lambda view: bool(view.figures.obstacle), ""),
)  # fmt: skip
"""Metrics of jobs that are no fields of their figures: name, help, value and unit."""


def metric(
    family: Family, name: str, words: str, labels: Sequence[str], samples: Samples, unit: str = ""
) -> Metric:
    """Return a metric with its samples; `name` lacks the common prefix."""
    found = family(f"qdgrasp_{name}", words, labels=labels, unit=unit)
    for values, value in samples:
        found.add_metric(values, float(value))
    return found


def figure_metrics(
    of: str, labels: Sequence[str], specs: Iterable[MetricSpec], found: Sequence[tuple[Sequence[str], Struct]]
) -> Iterator[Metric]:
    """Yield a metric for each spec, with a sample for each (label values, figures)."""
    for field, family, name, unit in specs if found else ():
        samples = [(values, getattr(figures, field)) for values, figures in found]
        words = meanings(type(found[0][1]))[field]
        yield metric(family, f"{of}_{name or field}", words, labels, samples, unit)


def exposition(views: Sequence[JobView]) -> tuple[bytes, str]:
    """Return the metrics of jobs in the text format of Prometheus, and its content type."""
    return generate_latest(JobCollector(views)), CONTENT_TYPE_PLAIN_0_0_4


class JobCollector(Collector):
    """Collects the metrics of jobs, of their runs and of their workers."""

    def __init__(self, views: Sequence[JobView]) -> None:
        self._views = views
        self._active = [view for view in views if view.state not in INACTIVE_STATES]

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics."""
        info = InfoMetricFamily("qdgrasp_job", "Host and version of the job's coordinator.", labels=("job",))
        for view in self._views:
            info.add_metric((view.job,), {"host": view.meta.host, "version": view.meta.version})
        yield info
        for name, words, value, unit in JOB_GAUGES:
            samples = [((view.job,), value(view)) for view in self._views]
            yield metric(GAUGE, name, words, ("job",), samples, unit)
        yield from self._states()
        for specs, views in ((JOB_METRICS, self._views), (COORDINATED_METRICS, self._active)):
            yield from figure_metrics("job", ("job",), specs, [((view.job,), view.figures) for view in views])
        yield from self._runs()
        yield from self._workers()

    def _states(self) -> Iterator[Metric]:
        def by_state(
            name: str, words: str, states: Callable[[JobView], Iterable[tuple[str, float]]]
        ) -> Metric:
            samples = [((view.job, state), n) for view in self._views for state, n in states(view)]
            return metric(GAUGE, name, words, ("job", "state"), samples)

        words = "How the job is: 1 for the state that holds."
        yield by_state("job_state", words, lambda view: [(each, view.state == each) for each in STATES])
        yield by_state("job_runs", "The job's runs by state.", lambda view: _run_states(view.figures))
        words = "Shapes that the job needs, by state."
        yield by_state("job_scenes", words, lambda view: _scene_states(view.figures))
        events = [((view.job,), view.events[-1].number if view.events else 0) for view in self._views]
        yield metric(COUNTER, "job_events", meanings(JobEvent)["number"], ("job",), events)

    def _runs(self) -> Iterator[Metric]:
        runs, labels = (
            [((view.job, run.run), run) for view in self._views for run in view.runs],
            ("job", "run"),
        )
        words = "Hand, object, method, protocol and seed of a run."
        info = InfoMetricFamily("qdgrasp_run", words, labels=labels)
        for values, run in runs:
            info.add_metric(values, {name: str(getattr(run, name)) for name in RUN_LABELS})
        yield info
        over = [(values, bool(run.finished)) for values, run in runs]
        yield metric(GAUGE, "run_finished", "Whether the run is over.", labels, over)
        ends = [((*values, name), n) for values, run in runs for name, n in run.outcomes.items()]
        yield metric(COUNTER, "run_outcomes", meanings(RunStatus)["outcomes"], (*labels, "outcome"), ends)
        yield from figure_metrics("run", labels, RUN_METRICS, runs)

    def _workers(self) -> Iterator[Metric]:
        counts = Counter((view.job, each.host, each.state) for view in self._active for each in view.workers)
        words = f"Workers on a host: {meanings(WorkerStatus)['state']}"
        yield metric(GAUGE, "workers", words, ("job", "host", "state"), counts.items())
        shown = [(view.job, each) for view in self._active for each in view.workers[:MOST_WORKERS]]
        workers = [((job, each.wid, each.host), each) for job, each in shown]
        yield from figure_metrics("worker", ("job", "worker", "host"), WORKER_METRICS, workers)


def _scene_states(job: JobStatus) -> Iterator[tuple[str, int]]:
    yield "done", job.scenes_done
    yield "failed", job.scenes_failed
    yield "waiting", max(0, job.scenes - job.scenes_done - job.scenes_failed)


def _run_states(job: JobStatus) -> Iterator[tuple[str, int]]:
    yield "open", job.runs_open
    yield "done", job.runs_done
    yield "failed", job.runs_failed
    yield "waiting", max(0, job.runs - job.runs_open - job.runs_done - job.runs_failed)
