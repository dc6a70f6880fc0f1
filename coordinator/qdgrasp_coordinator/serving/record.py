"""Where a run's rows go: to the recorder over the bus, or, where only a result is wanted, to memory."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from qdgrasp_coordinator.counts.stretch import Stretch, from_message, to_message
from qdgrasp_coordinator.serving.outbox import Outbox
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import Faulty, InputError, NoReply, RecorderFellBack, Refused, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import (
    Log,
    Message,
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
PATIENCE, MOST_PATIENCE = 1.0, 10.0
"""Seconds that a question to a recorder waits, at first and at most: one on a link that was lost is lost, and
each that was waited for in vain doubles it, for a recorder may be slow."""


class Record(ABC):
    """Takes the settled rows of a run, in journal order."""

    trouble: str = ""
    """Why rows cannot be written now, in words; empty when they can."""

    @abstractmethod
    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Open the run: the epoch to use, and how many rows are recorded already.

        Parameters
        ----------
        epoch
            The coordinator's turn at the job; 0: one begins.
        wait
            Called between two tries; it may raise to end them.
        """

    @abstractmethod
    def recorded(self, first: int, wait: Callable[[], None]) -> Stretch:
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

    @abstractmethod
    def heard(self, message: Recorded, now: float) -> None:
        """Take note of what a recorder reports."""

    @abstractmethod
    def recorder_up(self, now: float) -> None:
        """A recorder appeared."""

    @property
    @abstractmethod
    def durable(self) -> int:
        """How many rows of the run are safe."""

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

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Ask the recorder to open the run, again and again until one answers.

        Raises
        ------
        InputError
            The recorder holds another run, and says so.
        TookOver
            It answers another coordinator by now.
        """
        try:
            request = Open(job=self._job, runs=[run], epoch=epoch)
            opened = codec.decode(self._ask(self._keys.open, request, wait), Opened)
        except (Refused, Faulty) as refusal:
            over = TookOver.told_by(refusal, self._job)
            raise over or InputError(f"The recorder does not open job '{self._job}': {refusal}.") from None
        self._run, self._epoch = run.run, opened.epoch
        self._outbox = Outbox(opened.durable[0])
        self._platform = opened.platform
        return opened

    def recorded(self, first: int, wait: Callable[[], None]) -> Stretch:
        """A page of rows from the recorder's journal.

        Raises
        ------
        InputError
            The recorder cannot read it, and says why.
        """
        try:
            request = Log(run=self._run, first=first, limit=PAGE)
            page = codec.decode(self._ask(self._keys.log, request, wait), Recordable)
        except (Refused, Faulty) as refusal:
            raise InputError(
                f"The recorder does not show the rows of run '{self._run}': {refusal}."
            ) from None
        return from_message(page, self._shape)

    def _ask(self, key: str, request: Message, wait: Callable[[], None]) -> bytes:
        """The recorder's answer, asked for until it comes: a dead recorder is started again."""
        patience = PATIENCE
        while True:
            began = time.monotonic()
            try:
                answer = self._bus.ask(key, codec.encode(request), timeout=patience)
            except NoReply:
                if time.monotonic() >= began + patience:
                    patience = min(2 * patience, MOST_PATIENCE)
                self.trouble = f"no recorder of job '{self._job}' answers, or its disk is full"
                wait()
            else:
                self.trouble = ""
                return answer

    def push(self, stretch: Stretch) -> None:
        """Keep rows until they are durable."""
        self._outbox.push(stretch)

    def set_platform(self, platform: dict[str, str]) -> None:
        """Tell the recorder the platform, again before each burst of rows: one may have been lost."""
        self._platform = platform

    def heard(self, message: Recorded, now: float) -> None:
        """Take note of what is durable."""
        if message.epoch > self._epoch > 0:
            raise TookOver(self._job, message.epoch)
        if message.run != self._run or message.epoch != self._epoch:
            return
        self.trouble = message.trouble
        try:
            self._outbox.durable(message.durable, now)
        except RecorderFellBack as fallen:
            raise fallen.of(self._run) from None

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
        self.platform: dict[str, str] = {}
        """What the rows were made on; empty before a worker came."""

    @property
    def rows(self) -> Rows:
        """Everything taken, in journal order."""
        return np.concatenate([self._shape.empty(0), *self._parts])

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Begin: nothing is recorded."""
        return Opened(epoch=1, durable=[0], platform={})

    def recorded(self, first: int, wait: Callable[[], None]) -> Stretch:
        """Nothing is recorded."""
        return Stretch(first, self._shape.empty(0))

    def push(self, stretch: Stretch) -> None:
        """Keep the rows."""
        self._parts.append(stretch.rows)

    def set_platform(self, platform: dict[str, str]) -> None:
        """Note the platform."""
        self.platform = platform

    def tick(self, now: float) -> None:
        """Nothing is sent."""

    def heard(self, message: Recorded, now: float) -> None:
        """No recorder is listened to."""

    def recorder_up(self, now: float) -> None:
        """No recorder is needed."""

    @property
    def durable(self) -> int:
        """Everything taken."""
        return sum(map(len, self._parts))

    @property
    def is_full(self) -> bool:
        """Memory takes it all."""
        return False

    @property
    def is_empty(self) -> bool:
        """What is kept is safe."""
        return True
