"""The link to the recorder: where the rows of a run go that is to stay."""

import time
from collections.abc import Callable

from qdgrasp_coordinator.counts.stretch import Stretch, from_message, to_message
from qdgrasp_coordinator.serving.outbox import Outbox
from qdgrasp_coordinator.serving.record import Record
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
from qdgrasp_protocol.rows import Shape

PAGE = 2048
"""Rows in one page of a replay."""
PATIENCE, MOST_PATIENCE = 1.0, 10.0
"""Seconds that a question to a recorder waits, at first and at most: one on a link that was lost is lost, and
each that was waited for in vain doubles it, for a recorder may be slow."""


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
