"""Where a run's rows go: to the recorder over the bus, or, where only a result is wanted, to memory."""

import time
from abc import ABC, abstractmethod

import numpy as np

from qdgrasp_coordinator.outbox import Outbox
from qdgrasp_coordinator.stretch import Stretch, from_message, to_message
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import EndedEarly, NoReply
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import (
    Log,
    Open,
    Opened,
    OpenRun,
    Platform,
    Recordable,
    Recorded,
)
from qdgrasp_protocol.rows import Rows, Shape

PAGE = 2048
"""Rows in one page of a replay."""
PATIENCE = 120.0  # seconds to wait for a recorder at the start; it may be waiting for room on its disk
ASK_INTERVAL = 0.1  # seconds between two questions while no recorder answers


class Record(ABC):
    """Takes the settled rows of a run, in journal order."""

    @abstractmethod
    def open(self, run: OpenRun, stop: Stop) -> Opened:
        """Open the run: the epoch to use, and how many rows are recorded already."""

    @abstractmethod
    def recorded(self, first: int) -> Stretch:
        """Recorded rows from number `first` on, some at least if there are any."""

    @abstractmethod
    def push(self, stretch: Stretch) -> None:
        """Take rows that became final."""

    @abstractmethod
    def set_platform(self, platform: dict[str, str]) -> None:
        """Note the platform of this job's rows."""

    @abstractmethod
    def tick(self, now: float) -> None:
        """Send what is due."""

    @property
    @abstractmethod
    def is_full(self) -> bool:
        """So much is unconfirmed that nothing new should be asked."""

    @property
    @abstractmethod
    def is_empty(self) -> bool:
        """Everything taken is safe."""


class RecorderLink(Record):
    """The recorder at the other end of the bus (docs/bus.md, rule 8)."""

    def __init__(self, bus: Bus, job: str, shape: Shape) -> None:
        self._bus = bus
        self._keys = Keys(job)
        self._job = job
        self._shape = shape
        self._run = ""
        self._epoch = 0
        self._outbox = Outbox(0)
        self._platform: dict[str, str] = {}
        self.trouble = ""
        """Why the recorder cannot write, in its own words; empty when it can."""

    def open(self, run: OpenRun, stop: Stop) -> Opened:
        """Ask the recorder to open the job, again and again until one answers.

        Raises
        ------
        Refused
            The recorder holds another run, or a newer coordinator.
        EndedEarly
            No recorder answered.
        """
        request = codec.encode(Open(job=self._job, runs=[run]))
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                opened = codec.decode(self._bus.ask(self._keys.open, request, timeout=10.0), Opened)
                break
            except NoReply:
                if stop.is_set or time.monotonic() > deadline:
                    raise EndedEarly(f"No recorder of job '{self._job}' answered.") from None
                time.sleep(ASK_INTERVAL)  # until a recorder declares itself
        self._run, self._epoch = run.run, opened.epoch
        self._outbox = Outbox(opened.durable[0])
        self._platform = opened.platform
        return opened

    def recorded(self, first: int) -> Stretch:
        """A page of rows from the recorder's journal."""
        request = codec.encode(Log(run=self._run, first=first, limit=PAGE))
        page = codec.decode(self._bus.ask(self._keys.log, request, timeout=10.0), Recordable)
        return from_message(page, self._shape)

    def push(self, stretch: Stretch) -> None:
        """Keep rows until they are durable."""
        self._outbox.push(stretch)

    def set_platform(self, platform: dict[str, str]) -> None:
        """Tell the recorder the platform, again before each burst of rows: one may have been lost."""
        self._platform = platform

    def heard(self, message: Recorded, now: float) -> None:
        """Take note of what is durable."""
        if message.run == self._run and message.epoch == self._epoch:
            self._outbox.durable(message.durable, now)
            self.trouble = message.trouble

    def recorder_up(self, now: float) -> None:
        """A recorder appeared: send again what is not durable."""
        self._outbox.recorder_up(now)

    def tick(self, now: float) -> None:
        """Send the rows that are due."""
        parts = self._outbox.due(now)
        if parts:
            self._put(self._keys.outcome(self._epoch), Platform(epoch=self._epoch, platform=self._platform))
        for part in parts:
            message = to_message(part, self._run, self._epoch, self._shape)
            self._put(self._keys.outcome(self._epoch), message)

    @property
    def is_full(self) -> bool:
        """More rows are unconfirmed than should be."""
        return self._outbox.is_full

    @property
    def is_empty(self) -> bool:
        """All rows are durable."""
        return self._outbox.is_empty

    @property
    def durable(self) -> int:
        """How many rows of the run are on disk."""
        return self._outbox.confirmed

    def _put(self, key: str, message: Recordable | Platform) -> None:
        kind = type(message)
        self._bus.put(key, codec.encode(message), encoding=codec.encoding(kind), channel=Channel.DATA)


class Memory(Record):
    """Keeps the rows: for a job whose result is wanted at once and not for later."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._parts: list[Rows] = []

    @property
    def rows(self) -> Rows:
        """Everything taken, in journal order."""
        return np.concatenate([self._shape.empty(0), *self._parts])

    def open(self, run: OpenRun, stop: Stop) -> Opened:
        """Begin: nothing is recorded."""
        return Opened(epoch=1, durable=[0], platform={})

    def recorded(self, first: int) -> Stretch:
        """Nothing is recorded."""
        return Stretch(first, self._shape.empty(0))

    def push(self, stretch: Stretch) -> None:
        """Keep the rows."""
        self._parts.append(stretch.rows)

    def set_platform(self, platform: dict[str, str]) -> None:
        """Nobody asks."""

    def tick(self, now: float) -> None:
        """Nothing is sent."""

    @property
    def is_full(self) -> bool:
        """Memory takes it all."""
        return False

    @property
    def is_empty(self) -> bool:
        """What is kept is safe."""
        return True
