"""Feed of the jobs on a bus: reads messages into the models, and queries what is missing.

Messages wait in ring buffers until a thread takes them: however slow a monitor is, and though it be stopped,
no other process waits for it. Another thread sends the queries: a missing answer delays nothing.
`reachable_jobs` queries once, for commands that print and end.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from queue import SimpleQueue
from typing import Self

import structlog

from qdgrasp_protocol.bus import Bus, RingBuffer
from qdgrasp_protocol.errors import BusError
from qdgrasp_protocol.keys import AnyJob, Keys
from qdgrasp_protocol.text import first_few
from qdgrasp_tools.monitor.job_model import JobModels, JobView

log = structlog.get_logger()

INTERVAL = 0.1  # seconds between two readings of the rings
ANSWER_SECONDS = 1.0  # seconds that coordinators may take to answer
OVERVIEW_SECONDS = 2.0  # seconds that they may take where commands print and end
SHOWN = 6  # The most hosts that are named of each job
SUBSCRIBED_KEYS: dict[str, int] = {
    "meta": 64,
    "stat/job": 256,
    "stat/run/*": 2048,
    "stat/team/*": 512,
    "event/*": 512,
}
"""Subscribed keys below a job's, with the capacity of their rings; `meta` comes first."""

Change = Callable[[JobModels, float], None]


class Feed:
    """The jobs on a bus, or one of them, kept up to date while its context lasts.

    `bus` is an open session of a monitor, to be closed by its owner after the feed.
    """

    def __init__(self, bus: Bus, job: str | None = None) -> None:
        self._bus = bus
        self._keys = Keys(job) if job else AnyJob()
        self._jobs = JobModels(self._keys)
        self._changes: SimpleQueue[Change] = SimpleQueue()
        self._queries: SimpleQueue[list[str]] = SimpleQueue()
        self._changed = threading.Condition()  # held while the jobs are read or changed
        self._version = 0
        self._is_over = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        enter, put = self._stack.enter_context, self._changes.put
        rings = [enter(self._bus.ring(f"{self._keys.root}/{key}", n)) for key, n in SUBSCRIBED_KEYS.items()]
        enter(self._bus.on_link(lambda up: put(lambda jobs, now: jobs.link_changed(up, now))))
        token = self._keys.coordinator_token()
        enter(self._bus.watch(
            token, lambda key, alive: put(lambda jobs, now: jobs.coordinator_changed(key, alive, now))
        ))  # fmt: skip
        for work in (lambda: self._read(rings), self._query):
            thread = threading.Thread(target=work, name="feed", daemon=True)
            thread.start()
            self._stack.callback(thread.join)
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._queries.put([])
        self._stack.close()

    def views(self) -> list[JobView]:
        """Return the jobs as they are now, by their names; safe in any thread."""
        with self._changed:
            return self._jobs.views(time.time())

    @property
    def is_linked(self) -> bool:
        """False while the router cannot be reached."""
        return self._jobs.is_linked

    def wait(self, timeout: float) -> bool:
        """Wait for a message, for so many seconds at most; False where none came."""
        with self._changed:
            version = self._version
            return self._changed.wait_for(lambda: self._version != version, timeout)

    def _read(self, rings: list[RingBuffer]) -> None:
        """Thread: read messages into the models, and hand due queries to the other thread."""
        while not self._is_over.wait(INTERVAL):
            changes = [self._changes.get() for _ in range(self._changes.qsize())]
            samples = [sample for ring in rings for sample in ring.take()]
            with self._changed:
                now = time.time()
                for change in changes:
                    change(self._jobs, now)
                for sample in samples:
                    self._jobs.receive(sample.key, sample.payload, now)
                if queries := self._jobs.due_queries(now):
                    self._queries.put(queries)
                if changes or samples:
                    self._notify()

    def _query(self) -> None:
        """Thread: send queries, and read the answers into the models."""
        while not self._is_over.is_set():
            values: dict[str, bytes] = {}
            for pattern in self._queries.get():
                values |= {} if self._is_over.is_set() else self._answers(pattern)
            with self._changed:
                self._jobs.receive_answers(values, time.time())
                self._notify()

    def _answers(self, pattern: str) -> dict[str, bytes]:
        try:
            return self._bus.ask_all(pattern, timeout=ANSWER_SECONDS)
        except BusError as error:
            log.warning("nothing can be asked", reason=str(error))
            return {}

    def _notify(self) -> None:
        self._version += 1
        self._changed.notify_all()


def reachable_jobs(bus: Bus) -> list[JobView]:
    """Return the jobs whose coordinators answer now, by name."""
    jobs = JobModels()
    queries = jobs.due_queries(time.time())
    with ThreadPoolExecutor(len(queries)) as pool:  # a missing answer is waited for once
        answers = list(pool.map(lambda query: bus.ask_all(query, timeout=OVERVIEW_SECONDS), queries))
    jobs.receive_answers({key: value for values in answers for key, value in values.items()}, time.time())
    return jobs.views(time.time())


def summary_lines(view: JobView) -> Iterator[str]:
    """Yield a few lines about a job for a person."""
    meta, figures = view.meta, view.figures
    yield f"{view.job}: {view.state} on {meta.host} (process {meta.pid}, epoch {meta.epoch})"
    yield f"  {figures.words}, {figures.left}"
    hosts = Counter(worker.host for worker in view.workers).most_common()
    counts = ", ".join(f"{n} {state}" for state, n in Counter(each.state for each in view.workers).items())
    words = f"{first_few([f'{host} {n}' for host, n in hosts], SHOWN)} ({counts})"
    yield f"  workers: {words if hosts else 'none has joined'}"
    if not figures.recorders:
        yield "  no recorder is there: found rows wait for one"
