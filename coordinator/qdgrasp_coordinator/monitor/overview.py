"""The overview of the jobs on a bus: what runs where, since when, and how far."""

import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime

from qdgrasp_coordinator.monitor.jobs import Jobs, JobView
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.phrases import counted, few

SHOWN = 6
"""So many runs and hosts are named of each job."""
ANSWER = 2.0  # seconds that coordinators may take to answer


def look(bus: Bus) -> Jobs:
    """The jobs whose coordinators answer now."""
    jobs = Jobs()
    questions = jobs.questions(time.time())
    with ThreadPoolExecutor(len(questions)) as pool:  # one that stands still is waited for once
        answers = list(pool.map(lambda question: bus.ask_all(question, timeout=ANSWER), questions))
    jobs.answered({key: value for values in answers for key, value in values.items()}, time.time())
    return jobs


def overview(bus: Bus) -> list[JobView]:
    """The jobs whose coordinators answer now, by name."""
    return look(bus).views(time.time())


def lines(view: JobView, now: datetime) -> Iterator[str]:
    """A few lines about a job for a person; `now` is a time with its zone."""
    meta, figures = view.meta, view.figures
    ago = span(round((now - meta.since).total_seconds()))
    yield f"{view.job}: {view.state} on {meta.host} (process {meta.pid}, epoch {meta.epoch}) for {ago}"
    yield f"  {figures.words}, {figures.left}"
    yield from (f"  {line}" for line in (_runs(view), _workers(view), _recorder(view)) if line)


def span(seconds: int) -> str:
    """A time in words: 0:03:20, or 2 d 4:00:00."""
    days, rest = divmod(max(0, seconds), 86_400)
    clock = f"{rest // 3600}:{rest // 60 % 60:02d}:{rest % 60:02d}"
    return f"{days} d {clock}" if days else clock


def utc_now() -> datetime:
    """The time of the day."""
    return datetime.now(UTC)


def _runs(view: JobView) -> str:
    if view.figures.runs <= 1:
        return ""
    told = [f"{one.run} {one.evaluations}/{one.budget}" for one in view.runs]
    return f"{counted(len(told), 'run')} in progress" + (f": {few(told, SHOWN)}" if told else "")


def _workers(view: JobView) -> str:
    hosts = Counter(worker.host for worker in view.workers)
    states = Counter(worker.state for worker in view.workers)
    told = [f"{host} {n}" for host, n in hosts.most_common()]
    how = ", ".join(f"{n} {state}" for state, n in sorted(states.items()))
    return f"workers: {few(told, SHOWN)} ({how})" if told else "workers: none has joined"


def _recorder(view: JobView) -> str:
    return "" if view.figures.recorders else "no recorder is there: found rows wait for one"
