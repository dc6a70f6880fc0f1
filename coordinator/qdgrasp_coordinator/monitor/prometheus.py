"""The figures of jobs as metrics for Prometheus, named and typed by its conventions.

Metrics of a job begin with `qdgrasp_job_`, those of a run with `qdgrasp_run_`, those of a worker with
`qdgrasp_worker_`, so that nobody adds parts to their sum. What only grows is a counter and ends in `_total`;
a unit stands before that. What comes from elsewhere is a label's value, never a name. What a metric means is
written where its figure is defined (`counts`).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
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
from qdgrasp_coordinator.monitor.job_view import OVER, JobView

MOST_RUNS = 256
"""So many runs of a job have series of their own: those in progress first, then those heard of last."""
MOST_WORKERS = 512
"""So many workers of a job have: those that joined first. `qdgrasp_workers` counts them all."""
UNHEARD_STATES = ("silent", *OVER)  # The states of a job that nobody speaks for
STATES = ("starting", "running", "paused", "ending", *UNHEARD_STATES)  # Of a job: see `JobView`
KIND = ("gripper", "object", "method", "protocol", "seed")  # What a run is named for
TEAM = ("job", "host", "state")

Family: TypeAlias = type[CounterMetricFamily] | type[GaugeMetricFamily]
Samples: TypeAlias = Iterable[tuple[Sequence[str], float]]
"""The values of a metric's labels, and its own."""


@dataclass(frozen=True)
class MetricSpec:
    """A figure that is a metric."""

    field: str
    family: Family = CounterMetricFamily
    name: str = ""
    """Where it is not the field's."""
    unit: str = ""


@dataclass(frozen=True)
class MetricGroup:
    """What has figures: a job, a run or a worker."""

    name: str
    labels: tuple[str, ...]
    figures: type[Struct]
    shown: tuple[MetricSpec, ...]

    def metrics(self, found: Iterable[tuple[Sequence[str], Struct]]) -> Iterator[Metric]:
        """A metric of each figure, with a sample for each that has it, given by the values of its labels."""
        all_found, words = list(found), meanings(self.figures)
        for one in self.shown:
            samples = [(labels, float(getattr(figures, one.field))) for labels, figures in all_found]
            name = f"{self.name}_{one.name or one.field}"
            yield metric(one.family, name, words[one.field], self.labels, samples, one.unit)


def metric(
    family: Family, name: str, words: str, labels: Sequence[str], samples: Samples, unit: str = ""
) -> Metric:
    """A metric with its samples; `name` lacks what all have in common."""
    found = family(f"qdgrasp_{name}", words, labels=labels, unit=unit)
    for values, value in samples:
        found.add_metric(values, value)
    return found


COUNT_METRICS = (
    MetricSpec("evaluations"),
    MetricSpec("trials"),
    MetricSpec("simulated"),
    MetricSpec("proposals"),
    MetricSpec("overlaps"),
    MetricSpec("dead_ends"),
    MetricSpec("successes"),
    MetricSpec("grasps"),
    MetricSpec("robust"),
    MetricSpec("errors"),
    MetricSpec("cells", GaugeMetricFamily),
    MetricSpec("budget", GaugeMetricFamily, unit="evaluations"),
)
"""What jobs and runs have both."""
JOB = MetricGroup("job", ("job",), JobStatus, (
    *COUNT_METRICS,
    MetricSpec("remaining", GaugeMetricFamily, unit="evaluations"),
))  # fmt: skip
COORDINATED_JOB = MetricGroup("job", ("job",), JobStatus, (
    MetricSpec("requeued", name="requeued_batches"),
    MetricSpec("strays", name="stray_results"),
    MetricSpec("waiting", GaugeMetricFamily, unit="rows"),
    MetricSpec("workers", GaugeMetricFamily),
    MetricSpec("recorders", GaugeMetricFamily),
))  # fmt: skip
"""What holds of a job while somebody speaks for it."""
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
    """What is known of jobs, in the text format of Prometheus, and its content type."""
    return generate_latest(JobCollector(views)), CONTENT_TYPE_PLAIN_0_0_4


class JobCollector(Collector):
    """What a monitor knows of jobs, as metrics."""

    def __init__(self, views: Sequence[JobView]) -> None:
        self._views = views
        self._heard = [view for view in views if view.state not in UNHEARD_STATES]
        self._runs = [((view.job, run.run), run) for view in views for run in view.foremost(MOST_RUNS)]

    def collect(self) -> Iterator[Metric]:
        """All metrics: those of jobs, of runs, of workers."""
        yield from self._turns()
        yield from self._states()
        yield from JOB.metrics(((view.job,), view.figures) for view in self._views)
        yield from COORDINATED_JOB.metrics(((view.job,), view.figures) for view in self._heard)
        yield from self._kinds()
        yield from RUN.metrics(self._runs)
        yield self._team()
        yield from WORKER.metrics(
            ((view.job, each.wid, each.host), each)
            for view in self._heard
            for each in view.workers[:MOST_WORKERS]
        )

    def _turns(self) -> Iterator[Metric]:
        """Who carries the jobs out, since when."""
        info = InfoMetricFamily("qdgrasp_job", "Who carries a job out.", labels=("job",))
        for view in self._views:
            info.add_metric((view.job,), {"host": view.meta.host, "version": view.meta.version})
        yield info
        words = meanings(JobMeta)
        yield self._gauge("job_epoch", words["epoch"], lambda view: view.meta.epoch)
        yield self._gauge(
            "job_start_time", words["since"], lambda view: view.meta.since.timestamp(), "seconds"
        )

    def _states(self) -> Iterator[Metric]:
        """How the jobs are."""
        yield self._gauge(
            "up", "Whether the job's coordinator is heard.", lambda view: view.state not in UNHEARD_STATES
        )
        words = "Whether something keeps the job from going on."
        yield self._gauge("job_trouble", words, lambda view: bool(view.figures.obstacle))
        states = [((view.job, state), float(view.state == state)) for view in self._views for state in STATES]
        yield metric(
            GaugeMetricFamily,
            "job_state",
            "How the job is: 1 for the state that holds.",
            ("job", "state"),
            states,
        )
        runs = [((view.job, how), float(n)) for view in self._views for how, n in _runs(view.figures)]
        yield metric(GaugeMetricFamily, "job_runs", "The job's runs by state.", ("job", "state"), runs)
        events = [((view.job,), float(view.events[-1].number if view.events else 0)) for view in self._views]
        yield metric(CounterMetricFamily, "job_events", meanings(JobEvent)["number"], ("job",), events)

    def _kinds(self) -> Iterator[Metric]:
        """What the runs are, and how their evaluations end."""
        info = InfoMetricFamily("qdgrasp_run", "What a run is.", labels=("job", "run"))
        for labels, run in self._runs:
            info.add_metric(labels, {name: str(getattr(run, name)) for name in KIND})
        yield info
        over = [(labels, float(bool(run.finished))) for labels, run in self._runs]
        yield metric(GaugeMetricFamily, "run_finished", "Whether the run is over.", RUN.labels, over)
        ends = [((*labels, how), float(n)) for labels, run in self._runs for how, n in run.outcomes.items()]
        words = meanings(RunStatus)["outcomes"]
        yield metric(CounterMetricFamily, "run_outcomes", words, (*RUN.labels, "outcome"), ends)

    def _team(self) -> Metric:
        """All workers, whatever their number."""
        counts = Counter((view.job, each.host, each.state) for view in self._heard for each in view.workers)
        samples = [(labels, float(n)) for labels, n in counts.items()]
        words = meanings(WorkerStatus)["state"]
        return metric(GaugeMetricFamily, "workers", f"Workers on a host: {words}", TEAM, samples)

    def _gauge(self, name: str, words: str, value: Callable[[JobView], float], unit: str = "") -> Metric:
        samples = [((view.job,), float(value(view))) for view in self._views]
        return metric(GaugeMetricFamily, name, words, ("job",), samples, unit)


def _runs(job: JobStatus) -> Iterator[tuple[str, int]]:
    """How many of a job's runs are how."""
    yield "open", job.runs_open
    yield "done", job.runs_done
    yield "failed", job.runs_failed
    yield "waiting", max(0, job.runs - job.runs_open - job.runs_done - job.runs_failed)
