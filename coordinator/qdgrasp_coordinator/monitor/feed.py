"""Feeds what travels on the bus into the model of the jobs.

Messages wait in ring channels until a thread takes them: however slow a monitor is, and though it be
stopped, no other process waits for it. Another thread asks what is to be asked: an answer that does not come
delays nothing. `overview` asks once, for commands that print and end.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from datetime import UTC, datetime
from queue import SimpleQueue
from typing import Self

import structlog

from qdgrasp_coordinator.monitor.job_model import JobModels
from qdgrasp_coordinator.monitor.job_view import JobView
from qdgrasp_protocol.bus import Bus, RingBuffer
from qdgrasp_protocol.errors import BusError
from qdgrasp_protocol.keys import AnyJob, Keys
from qdgrasp_protocol.text import counted, first_few

log = structlog.get_logger()

INTERVAL = 0.1  # seconds between two looks at the rings
ANSWER_SECONDS = 1.0  # seconds that coordinators may take to answer
SUBSCRIBED_KEYS: dict[str, int] = {
    "meta": 64,
    "stat/job": 256,
    "stat/run/*": 2048,
    "stat/team/*": 512,
    "event/*": 512,
}
"""What is heard, and how many messages of it may wait; first whose it is.

Workers' own signs are not for monitors.
"""

Change = Callable[[JobModels, float], None]


class Feed:
    """What is known of the jobs on a bus, kept up to date while its context lasts.

    Parameters
    ----------
    bus
        An open session of a monitor; who opened it closes it, after the feed.
    job
        The one job to watch; None: whatever there is.
    """

    def __init__(self, bus: Bus, job: str | None = None) -> None:
        self._bus = bus
        self._keys = Keys(job) if job else AnyJob()
        self._jobs = JobModels(self._keys)
        self._changes: SimpleQueue[Change] = SimpleQueue()
        self._questions: SimpleQueue[list[str]] = SimpleQueue()
        self._news = threading.Condition()  # held while the jobs are looked at or changed
        self._number = 0
        self._is_over = threading.Event()
        self._doors = ExitStack()

    def __enter__(self) -> Self:
        enter = self._doors.enter_context
        rings = [
            enter(self._bus.ring(f"{self._keys.root}/{what}", most)) for what, most in SUBSCRIBED_KEYS.items()
        ]
        enter(self._bus.on_link(lambda up: self._changes.put(lambda jobs, now: jobs.linked(up, now))))
        enter(self._bus.watch(self._keys.coordinator_token(), self._token_changed))
        for work in (lambda: self._listen(rings), self._ask):
            thread = threading.Thread(target=work, name="feed", daemon=True)
            thread.start()
            self._doors.callback(thread.join)
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._questions.put([])
        self._doors.close()

    def views(self) -> list[JobView]:
        """The jobs as they are now, by their names; safe in any thread."""
        with self._news:
            return self._jobs.views(time.time())

    @property
    def is_linked(self) -> bool:
        """False while there is no way to the router."""
        return self._jobs.is_linked

    @property
    def strangers(self) -> list[str]:
        """Jobs that are there and cannot be shown: they speak as another version of qdgrasp does."""
        with self._news:
            return self._jobs.strangers

    def wait(self, timeout: float) -> bool:
        """Wait until something is heard, for so many seconds at most; False where nothing was."""
        with self._news:
            number = self._number
            return self._news.wait_for(lambda: self._number != number, timeout)

    # Its threads.

    def _token_changed(self, key: str, alive: bool) -> None:
        self._changes.put(lambda jobs, now: jobs.token(key, alive, now))

    def _listen(self, rings: list[RingBuffer]) -> None:
        """Bring what was heard into the model, and hand out what is to be asked."""
        while not self._is_over.wait(INTERVAL):
            changes = [self._changes.get() for _ in range(self._changes.qsize())]
            samples = [sample for ring in rings for sample in ring.take()]
            with self._news:
                now = time.time()
                for change in changes:
                    change(self._jobs, now)
                for sample in samples:
                    self._jobs.heard(sample.key, sample.payload, now)
                if questions := self._jobs.questions(now):
                    self._questions.put(questions)
                if changes or samples:
                    self._tell()

    def _ask(self) -> None:
        """Ask what is to be asked."""
        while not self._is_over.is_set():
            values: dict[str, bytes] = {}
            for pattern in self._questions.get():
                values |= {} if self._is_over.is_set() else self._answers(pattern)
            with self._news:
                self._jobs.answered(values, time.time())
                self._tell()

    def _answers(self, pattern: str) -> dict[str, bytes]:
        try:
            return self._bus.ask_all(pattern, timeout=ANSWER_SECONDS)
        except BusError as error:
            log.warning("nothing can be asked", reason=str(error))
            return {}

    def _tell(self) -> None:
        """Wake whoever waits."""
        self._number += 1
        self._news.notify_all()


SHOWN = 6  # So many runs and hosts are named of each job
OVERVIEW_SECONDS = 2.0  # seconds that coordinators may take to answer


def query_jobs(bus: Bus) -> JobModels:
    """The jobs whose coordinators answer now."""
    jobs = JobModels()
    questions = jobs.questions(time.time())
    with ThreadPoolExecutor(len(questions)) as pool:  # one that stands still is waited for once
        answers = list(pool.map(lambda question: bus.ask_all(question, timeout=OVERVIEW_SECONDS), questions))
    jobs.answered({key: value for values in answers for key, value in values.items()}, time.time())
    return jobs


def reachable_jobs(bus: Bus) -> list[JobView]:
    """The jobs whose coordinators answer now, by name."""
    return query_jobs(bus).views(time.time())


def summary_lines(view: JobView, now: datetime) -> Iterator[str]:
    """A few lines about a job for a person; `now` is a time with its zone."""
    meta, figures = view.meta, view.figures
    ago = duration_text(round((now - meta.since).total_seconds()))
    yield f"{view.job}: {view.state} on {meta.host} (process {meta.pid}, epoch {meta.epoch}) for {ago}"
    yield f"  {figures.words}, {figures.left}"
    yield from (f"  {line}" for line in (_runs(view), _workers(view), _recorder(view)) if line)


def duration_text(seconds: int) -> str:
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
    return f"{counted(len(told), 'run')} in progress" + (f": {first_few(told, SHOWN)}" if told else "")


def _workers(view: JobView) -> str:
    hosts = Counter(worker.host for worker in view.workers)
    states = Counter(worker.state for worker in view.workers)
    told = [f"{host} {n}" for host, n in hosts.most_common()]
    how = ", ".join(f"{n} {state}" for state, n in sorted(states.items()))
    return f"workers: {first_few(told, SHOWN)} ({how})" if told else "workers: none has joined"


def _recorder(view: JobView) -> str:
    return "" if view.figures.recorders else "no recorder is there: found rows wait for one"
