"""The overview of the jobs on a bus: what runs where, since when, and how far."""

from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import TypeVar

from msgspec import Struct

from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, from_json
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import AnyJob, Keys, job_of, matches

SHOWN = 6
"""So many runs and hosts are named of each job."""

Kind = TypeVar("Kind", Figures, JobFigures, JobMeta, WorkerFigures)


class JobView(Struct, frozen=True, kw_only=True):
    """A job as its coordinator shows it."""

    meta: JobMeta
    figures: JobFigures
    runs: list[Figures]
    """Those in progress."""
    workers: list[WorkerFigures]

    def lines(self, now: datetime) -> Iterator[str]:
        """A few lines for a person; `now` is a time with its zone."""
        meta, figures = self.meta, self.figures
        ago = _span(round((now - meta.since).total_seconds()))
        yield f"{meta.job}: {figures.state} on {meta.host} (process {meta.pid}, epoch {meta.epoch}) for {ago}"
        yield f"  {figures.words}, {figures.left}"
        yield from (f"  {line}" for line in (self._runs, self._workers, self._recorder) if line)

    @property
    def _runs(self) -> str:
        if self.figures.runs <= 1:
            return ""
        told = [f"{one.run} {one.evaluations}/{one.budget}" for one in self.runs]
        return f"{len(told)} runs in progress" + (f": {_listed(told)}" if told else "")

    @property
    def _workers(self) -> str:
        hosts = Counter(worker.host for worker in self.workers)
        states = Counter(worker.state for worker in self.workers)
        told = [f"{host} {n}" for host, n in hosts.most_common()]
        how = ", ".join(f"{n} {state}" for state, n in sorted(states.items()))
        return f"workers: {_listed(told)} ({how})" if told else "workers: none has joined"

    @property
    def _recorder(self) -> str:
        return "" if self.figures.recorders else "no recorder is there: found rows wait for one"


def overview(bus: Bus) -> list[JobView]:
    """The jobs whose coordinators answer now, by name."""
    any_job = AnyJob()
    return views(bus.ask_all(any_job.meta) | bus.ask_all(any_job.stat()))


def views(values: Mapping[str, bytes]) -> list[JobView]:
    """The jobs that values by key are of; what cannot be read is left out."""
    jobs = sorted({job for key in values if (job := job_of(key))})
    return [view for job in jobs for view in _view(Keys(job), values)]


def _view(keys: Keys, values: Mapping[str, bytes]) -> Iterator[JobView]:
    metas = _read(keys.meta, values, JobMeta)
    figures = _read(keys.stat("job"), values, JobFigures)
    runs = _read(keys.stat("run/*"), values, Figures)
    workers = _read(keys.stat("worker/*"), values, WorkerFigures)
    if metas and figures:
        yield JobView(meta=metas[0], figures=figures[0], runs=runs, workers=workers)


def _read(pattern: str, values: Mapping[str, bytes], kind: type[Kind]) -> list[Kind]:
    found = []
    for key in filter(lambda key: matches(pattern, key), values):
        try:
            found.append(from_json(values[key], kind))
        except MessageError:  # another version, or no coordinator of ours
            continue
    return found


def _listed(words: list[str]) -> str:
    more = f" and {len(words) - SHOWN} more" if len(words) > SHOWN else ""
    return ", ".join(words[:SHOWN]) + more


def _span(seconds: int) -> str:
    """A time in words: 0:03:20, or 2 d 4:00:00."""
    days, rest = divmod(max(0, seconds), 86_400)
    clock = f"{rest // 3600}:{rest // 60 % 60:02d}:{rest % 60:02d}"
    return f"{days} d {clock}" if days else clock


def utc_now() -> datetime:
    """The time of the day."""
    return datetime.now(UTC)
