"""Metrics of jobs for Prometheus, named and typed by its conventions.

Metrics of a job begin with `qdgrasp_job_`, those of a run with `qdgrasp_run_`, those of a worker with
`qdgrasp_worker_`, so that parts are not added to their sum. A figure that only grows is a counter and ends in
`_total`; a unit stands before that. Texts from elsewhere are labels' values, never names. The help of a
metric is the docstring of its figure (`metrics.job_status`).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

from msgspec import Struct
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.job_status import JobMeta, JobStatus, RunStatus, WorkerStatus, meanings
from qdgrasp_tools.monitor.job_model import OVER, JobView

MOST_RUNS = 256  # The most runs of a job with series: first those in progress, then the latest heard
MOST_WORKERS = 512  # The most workers of a job with series, by their joins; `qdgrasp_workers` counts all
INACTIVE_STATES = ("silent", *OVER)  # The states of a job without messages
STATES = ("starting", "running", "paused", "ending", *INACTIVE_STATES)  # States of a job: see `JobView`
RUN_LABELS = ("gripper", "object", "method", "protocol", "seed")  # Labels of `qdgrasp_run_info`

Family: TypeAlias = type[CounterMetricFamily] | type[GaugeMetricFamily]
Samples: TypeAlias = Iterable[tuple[Sequence[str], float]]  # Values of a metric's labels, and its own


class MetricSpec(NamedTuple):
    """A figure that is a metric; `name` where it is not the field's."""

    field: str
    family: Family = CounterMetricFamily
    name: str = ""
    unit: str = ""


class MetricGroup(NamedTuple):
    """The metrics of jobs, runs or workers, which are told apart by `labels`."""

    name: str
    labels: tuple[str, ...]
    figures: type[Struct]
    specs: tuple[MetricSpec, ...]

    def metrics(self, found: Iterable[tuple[Sequence[str], Struct]]) -> Iterator[Metric]:
        """Yield a metric for each spec, with a sample for each (label values, figures)."""
        all_found, words = list(found), meanings(self.figures)
        for spec in self.specs:
            samples = [(labels, float(getattr(figures, spec.field))) for labels, figures in all_found]
            name = f"{self.name}_{spec.name or spec.field}"
            yield metric(spec.family, name, words[spec.field], self.labels, samples, spec.unit)


def metric(
    family: Family, name: str, words: str, labels: Sequence[str], samples: Samples, unit: str = ""
) -> Metric:
    """Return a metric with its samples; `name` lacks the common prefix."""
    found = family(f"qdgrasp_{name}", words, labels=labels, unit=unit)
    for values, value in samples:
        found.add_metric(values, value)
    return found


COUNT_METRICS = (
    *map(MetricSpec, ("evaluations", "trials", "simulated", "proposals", "overlaps", "dead_ends")),
    *map(MetricSpec, ("successes", "grasps", "robust", "errors")),
    MetricSpec("cells", GaugeMetricFamily),
    MetricSpec("budget", GaugeMetricFamily, unit="evaluations"),
)
"""Metrics of both jobs and runs."""
JOB_GAUGES: tuple[tuple[str, str, Callable[[JobView], float], str], ...] = (
    ("job_epoch", meanings(JobMeta)["epoch"], lambda view: view.meta.epoch, ""),
    ("job_start_time", meanings(JobMeta)["since"], lambda view: view.meta.since.timestamp(), "seconds"),
    ("up", "Whether the job's coordinator is heard.", lambda view: view.state not in INACTIVE_STATES, ""),
    ("job_trouble", "Whether something keeps the job from going on.",
     lambda view: bool(view.figures.obstacle), ""),
)  # fmt: skip
"""Metrics of jobs that are no fields of their figures: name, help, value and unit."""
JOB = MetricGroup("job", ("job",), JobStatus, (
    *COUNT_METRICS,
    MetricSpec("remaining", GaugeMetricFamily, unit="evaluations"),
    MetricSpec("scenes_seconds", name="scenes_cpu_seconds"),
))  # fmt: skip
COORDINATED_JOB = MetricGroup("job", ("job",), JobStatus, (
    MetricSpec("requeued", name="requeued_batches"),
    MetricSpec("doubled", name="doubled_batches"),
    MetricSpec("strays", name="stray_results"),
    MetricSpec("waiting", GaugeMetricFamily, unit="rows"),
    MetricSpec("workers", GaugeMetricFamily),
    MetricSpec("wanted_workers", GaugeMetricFamily),
    MetricSpec("recorders", GaugeMetricFamily),
))  # fmt: skip
"""Metrics of a job while its coordinator publishes."""
RUN = MetricGroup("run", ("job", "run"), RunStatus, (
    MetricSpec("rows"),
    MetricSpec("durable", GaugeMetricFamily, unit="rows"),
    *COUNT_METRICS,
))  # fmt: skip
WORKER = MetricGroup("worker", ("job", "worker", "host"), WorkerStatus, (
    MetricSpec("rows"),
    MetricSpec("batches", GaugeMetricFamily),
    MetricSpec("memory", GaugeMetricFamily, unit="bytes"),
    MetricSpec("seen", GaugeMetricFamily, "silent", "seconds"),
    MetricSpec("restarts", name="simulator_restarts"),
))  # fmt: skip


def exposition(views: Sequence[JobView]) -> tuple[bytes, str]:
    """Return the metrics of jobs in the text format of Prometheus, and its content type."""
    return generate_latest(JobCollector(views)), CONTENT_TYPE_PLAIN_0_0_4


class JobCollector(Collector):
    """Collects the metrics of jobs, of their runs and of their workers."""

    def __init__(self, views: Sequence[JobView]) -> None:
        self._views = views
        self._active = [view for view in views if view.state not in INACTIVE_STATES]
        self._runs = [((view.job, run.run), run) for view in views for run in view.foremost(MOST_RUNS)]

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics."""
        yield from self._coordinators()
        yield from self._states()
        yield from JOB.metrics(((view.job,), view.figures) for view in self._views)
        yield from COORDINATED_JOB.metrics(((view.job,), view.figures) for view in self._active)
        yield from self._run_infos()
        yield from RUN.metrics(self._runs)
        yield from self._workers()

    def _coordinators(self) -> Iterator[Metric]:
        info = InfoMetricFamily("qdgrasp_job", "Host and version of the job's coordinator.", labels=("job",))
        for view in self._views:
            info.add_metric((view.job,), {"host": view.meta.host, "version": view.meta.version})
        yield info
        for name, words, value, unit in JOB_GAUGES:
            samples = [((view.job,), float(value(view))) for view in self._views]
            yield metric(GaugeMetricFamily, name, words, ("job",), samples, unit)

    def _states(self) -> Iterator[Metric]:
        views, gauge, labels = self._views, GaugeMetricFamily, ("job", "state")
        states = [((view.job, state), float(view.state == state)) for view in views for state in STATES]
        yield metric(gauge, "job_state", "How the job is: 1 for the state that holds.", labels, states)
        runs = [((view.job, state), float(n)) for view in views for state, n in _run_states(view.figures)]
        yield metric(gauge, "job_runs", "The job's runs by state.", labels, runs)
        scenes = [((view.job, state), float(n)) for view in views for state, n in _scene_states(view.figures)]
        yield metric(gauge, "job_scenes", "Shapes that the job needs, by state.", labels, scenes)
        events = [((view.job,), float(view.events[-1].number if view.events else 0)) for view in views]
        words = meanings(job_status.JobEvent)["number"]
        yield metric(CounterMetricFamily, "job_events", words, ("job",), events)

    def _run_infos(self) -> Iterator[Metric]:
        info = InfoMetricFamily(
            "qdgrasp_run", "Hand, object, method, protocol and seed of a run.", labels=("job", "run")
        )
        for labels, run in self._runs:
            info.add_metric(labels, {name: str(getattr(run, name)) for name in RUN_LABELS})
        yield info
        over = [(labels, float(bool(run.finished))) for labels, run in self._runs]
        yield metric(GaugeMetricFamily, "run_finished", "Whether the run is over.", RUN.labels, over)
        ends = [((*labels, name), float(n)) for labels, run in self._runs for name, n in run.outcomes.items()]
        words = meanings(RunStatus)["outcomes"]
        yield metric(CounterMetricFamily, "run_outcomes", words, (*RUN.labels, "outcome"), ends)

    def _workers(self) -> Iterator[Metric]:
        counts = Counter((view.job, each.host, each.state) for view in self._active for each in view.workers)
        words = f"Workers on a host: {meanings(WorkerStatus)['state']}"
        samples = [(labels, float(n)) for labels, n in counts.items()]
        yield metric(GaugeMetricFamily, "workers", words, ("job", "host", "state"), samples)
        shown = [(view.job, each) for view in self._active for each in view.workers[:MOST_WORKERS]]
        yield from WORKER.metrics(((job, each.wid, each.host), each) for job, each in shown)


def _scene_states(job: JobStatus) -> Iterator[tuple[str, int]]:
    yield "done", job.scenes_done
    yield "failed", job.scenes_failed
    yield "waiting", max(0, job.scenes - job.scenes_done - job.scenes_failed)


def _run_states(job: JobStatus) -> Iterator[tuple[str, int]]:
    yield "open", job.runs_open
    yield "done", job.runs_done
    yield "failed", job.runs_failed
    yield "waiting", max(0, job.runs - job.runs_open - job.runs_done - job.runs_failed)
