"""The feed: what travels on the bus for whoever watches, brought into the model of the jobs.

Messages wait in ring channels until a thread takes them: however slow a monitor is, and though it be
stopped, nobody waits for it. Another thread asks what is to be asked: an answer that does not come delays
nothing.
"""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from queue import SimpleQueue
from typing import Self

import structlog

from qdgrasp_coordinator.monitor.jobs import Jobs, JobView
from qdgrasp_protocol.bus import Bus, Ring
from qdgrasp_protocol.errors import BusError
from qdgrasp_protocol.keys import AnyJob, Keys

log = structlog.get_logger()

INTERVAL = 0.1  # seconds between two looks at the rings
ANSWER = 1.0  # seconds that coordinators may take to answer
NEWS: dict[str, int] = {"meta": 64, "stat/job": 256, "stat/run/*": 2048, "stat/team/*": 512, "event/*": 512}
"""What is heard, and how many messages of it may wait; first whose it is.

Workers' own signs are not for monitors.
"""

Change = Callable[[Jobs, float], None]


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
        self._jobs = Jobs(self._keys)
        self._changes: SimpleQueue[Change] = SimpleQueue()
        self._questions: SimpleQueue[list[str]] = SimpleQueue()
        self._news = threading.Condition()  # held while the jobs are looked at or changed
        self._number = 0
        self._is_over = threading.Event()
        self._doors = ExitStack()

    def __enter__(self) -> Self:
        enter = self._doors.enter_context
        rings = [enter(self._bus.ring(f"{self._keys.root}/{what}", most)) for what, most in NEWS.items()]
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

    def _listen(self, rings: list[Ring]) -> None:
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
            return self._bus.ask_all(pattern, timeout=ANSWER)
        except BusError as error:
            log.warning("nothing can be asked", reason=str(error))
            return {}

    def _tell(self) -> None:
        """Wake whoever waits."""
        self._number += 1
        self._news.notify_all()
