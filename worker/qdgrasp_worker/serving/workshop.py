"""The workshop: the batches at the simulator, and a simulator for them, whatever ends the one before."""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from math import inf
from pathlib import Path

import structlog

from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_worker.serving.docket import Docket
from qdgrasp_worker.serving.frames import Broken, Lacking, Part, Ready, Said, Settings
from qdgrasp_worker.serving.limits import PROBE_SECONDS, STALL
from qdgrasp_worker.serving.silence import Silence
from qdgrasp_worker.serving.simulator import Ended, Heard, News, Simulator, evidence
from qdgrasp_worker.serving.task import Task
from qdgrasp_worker.serving.vitals import NOTHING

log = structlog.get_logger()

PAUSES = (0.0, 0.5, 1.0, 2.0, 4.0)
"""Seconds before the next simulator, by how many were killed or did not start since a row was evaluated."""
LAST_PAUSE = 8.0
"""Seconds before each one after those."""
ROOM = 1.4
"""So many times the memory that a simulator may keep it may ask for within a batch."""
STRIKES = 3
"""A scene that ended so many simulators while it was loaded is not tried again."""
CHILD = [sys.executable, "-m", "qdgrasp_worker.serving.child"]


def child_of(evaluator: str | None) -> list[str]:
    """What starts a simulator: ours, or one with an evaluator that is named FILE.py:NAME or MODULE:NAME.

    Raises
    ------
    InputError
        That is no such name, or there is no such file.
    """
    if evaluator is None:
        return CHILD
    where, mark, name = evaluator.rpartition(":")
    if not (mark and where and name):
        raise InputError(f"An evaluator is named FILE.py:NAME or MODULE:NAME, got '{evaluator}'.")
    if where.endswith(".py"):
        if not Path(where).is_file():
            raise InputError(f"There is no file {where} to take the evaluator '{name}' from.")
        where = str(Path(where).resolve())
    return [sys.executable, "-m", "qdgrasp_worker.serving.own", f"{where}:{name}"]


class NoSimulator(QdgraspError):
    """A simulator that ends before it has evaluated the probes, with the reason."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"The simulator does not start: {reason}.")


class OtherPlatform(QdgraspError):
    """The simulator that was started again is not the one that this worker joined with."""

    def __init__(self) -> None:
        super().__init__("The package was changed while this worker ran; start it again.")


@dataclass(frozen=True)
class Upshot:
    """What came of news from the simulator."""

    done: list[Task] = field(default_factory=list)
    """Batches whose every row is known."""
    lost: list[Task] = field(default_factory=list)
    """Batches that a kill from outside took away; nothing is known against them."""


class Workshop:
    """Batches in, results out; a context manager that ends the simulator.

    Parameters
    ----------
    hire
        Starts a simulator; its news are to come back to `hear`.
    row_seconds
        What the simulator was told of its time, for the words with which it is mourned.
    memory
        The most that it may take between two batches [bytes]; above that another one is started.
    """

    def __init__(self, hire: Callable[[], Simulator], *, row_seconds: float, memory: int) -> None:
        self._hire = hire
        self._row_seconds = row_seconds
        self._memory = memory
        self._docket = Docket()
        self._scenes: set[str] = set()
        self._fatal: Counter[str] = Counter()
        self._pauses = pauses()
        self._silence = Silence()
        self._is_retiring = False
        self._last_words = ""
        self._vitals = NOTHING
        self.restarts = 0
        """How often another simulator was started."""
        self.platform: dict[str, str] | None = None
        """What decides the bits of its results; None until the first simulator has said it."""
        self.is_ready = False
        """A simulator is there that has evaluated the probes."""
        self.opens_at = inf
        """When the next simulator is to be started; infinite: there is one."""
        self._simulator = hire()

    @classmethod
    def open(
        cls,
        hear: Callable[[News], None],
        row_seconds: float,
        memory: int,
        nice: int,
        command: Sequence[str] = CHILD,
    ) -> "Workshop":
        """A workshop with simulators of its own, the first of which starts now."""
        settings = Settings(row_seconds=row_seconds, memory=round(ROOM * memory), nice=nice)
        return cls(lambda: Simulator(command, settings, hear), row_seconds=row_seconds, memory=memory)

    def __enter__(self) -> "Workshop":
        return self

    def __exit__(self, *_: object) -> None:
        self._simulator.close()

    # Batches.

    @property
    def has_room(self) -> bool:
        """A batch may be put in."""
        return self.is_ready and not self._is_retiring and self._docket.has_room

    @property
    def head(self) -> Task | None:
        """The batch that is worked on."""
        return self._docket.head

    @property
    def tasks(self) -> list[Task]:
        """All batches that are here."""
        return self._docket.tasks

    @property
    def next_again(self) -> Task | None:
        """A batch that was begun, and goes on before others: put it in again, or drop it."""
        return self._docket.next_again

    def has_scene(self, digest: str) -> bool:
        """Whether the simulator was given a scene."""
        return digest in self._scenes

    def is_fatal(self, digest: str) -> bool:
        """Whether a scene ended so many simulators while they loaded it that it is not tried again."""
        return self._fatal[digest] >= STRIKES

    def put(self, task: Task, bundle: bytes | None, now: float) -> None:
        """Let the simulator evaluate a batch, with its scene unless it has that."""
        if self.head is None:
            self._silence.begin(now)
        self._simulator.say(task.request(bundle))
        self._docket.send(task, now)
        self._scenes.add(task.work.scene)

    def drop(self, task: Task) -> None:
        """Forget `next_again`."""
        self._docket.drop(task)

    # News of the simulator.

    def hear(self, news: News, now: float) -> Upshot:
        """Take what the simulator says, or that it ended; what came late from an older one is passed over.

        Raises
        ------
        NoSimulator
            No simulator can be started here.
        OtherPlatform
            This one is of another platform than the one before.
        """
        if news.simulator is not self._simulator or self.opens_at < inf:
            return Upshot()
        if isinstance(news, Heard):
            return self._said(news.frame, now)
        return self._ended(news, now)

    def _said(self, frame: Said, now: float) -> Upshot:
        self._silence.begin(now)
        match frame:
            case Ready(platform=platform):
                self._welcome(platform)
            case Broken(reason=reason):
                self._last_words = reason
            case Lacking() if self.head is not None:
                self._scenes.discard(self.head.work.scene)
            case Part():
                self._pauses = pauses()
        done = self._docket.hear(frame, now)
        return Upshot(done=[done] if done else [])

    def _welcome(self, platform: dict[str, str]) -> None:
        if self.platform is not None and platform != self.platform:
            raise OtherPlatform
        self.platform = platform
        self.is_ready = True

    def _ended(self, news: Ended, now: float) -> Upshot:
        reason = self._last_words or evidence(news.code, self._row_seconds)
        if self.platform is None and reason:
            raise NoSimulator(reason)
        log.warning("the simulator ended; another one is started", reason=reason or "it was killed")
        is_of_a_row = reason is not None and self.is_ready
        self._close(now if is_of_a_row else now + next(self._pauses))
        if reason is None:
            return Upshot(lost=self._docket.lose())
        if self.head is not None and self.head.is_loading:
            self._fatal[self.head.work.scene] += 1
        done = self._docket.stumble(reason)
        return Upshot(done=[done] if done else [])

    # Time passes.

    @property
    def tick_at(self) -> float:
        """When `tick` has something to do if nothing happens before; infinite: never."""
        return min(self.opens_at, self._silence.look_at if self._is_at_work else inf)

    @property
    def _is_at_work(self) -> bool:
        """Something is awaited of a simulator that is there: the probes, or a batch."""
        return self.opens_at == inf and not (self.is_ready and self.head is None)

    def tick(self, now: float) -> None:
        """Start the next simulator when it is time, and end one that is silent, or takes too much memory."""
        if now >= self.opens_at:
            self.opens_at = inf
            self.restarts += 1
            self._simulator = self._hire()
        elif self._is_retiring and self.head is None:
            self._simulator.close()
            self._close(now)
        elif now >= self.tick_at:
            self._listen(now)

    def _listen(self, now: float) -> None:
        """End the simulator if it has been silent for too long."""
        self._silence.look(now, is_stopped=self._simulator.vitals.is_stopped)
        if self._silence.seconds > STALL * (self._row_seconds if self.is_ready else PROBE_SECONDS):
            self._silence.begin(now)
            self._simulator.stop()

    def look(self) -> bool:
        """Look at the simulator: whether it did anything since the last time, and what memory it takes."""
        before, self._vitals = self._vitals, self._simulator.vitals
        if self._vitals.memory > self._memory and not self._is_retiring:
            self._is_retiring = True
            log.warning("the simulator takes too much memory and is replaced", bytes=self._vitals.memory)
        return self._vitals.cpu_seconds != before.cpu_seconds

    @property
    def memory(self) -> int:
        """What the simulator took at the last look [bytes]."""
        return self._vitals.memory

    def _close(self, opens_at: float) -> None:
        """Forget the simulator that there was."""
        self.is_ready = self._is_retiring = False
        self.opens_at = opens_at
        self._last_words = ""
        self._silence = Silence()
        self._scenes.clear()


def pauses() -> chain[float]:
    """The pauses before the next simulators, from the first on."""
    return chain(PAUSES, repeat(LAST_PAUSE))
