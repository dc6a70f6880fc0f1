"""Sinks of a run's rows: a recorder, or memory where only a result is wanted.

Messages may be lost, repeated or overtaken. The outbox knows the number up to
which the recorder has reported rows durable, and sends everything behind it again when the recorder is new
or stands still (docs/bus.md, rule 8). Time is passed in, in seconds of any steady clock.
"""

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from qdgrasp_coordinator.storage.journal import (
    JournalSlice,
    join_slices,
    slice_from_message,
    slice_to_message,
)
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import Faulty, InputError, NoReply, RecorderFellBack, Refused, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Message, Open, Opened, OpenRun, Recordable, Recorded
from qdgrasp_protocol.rows import Rows, RowShape


class RowSink:
    """Takes the settled rows of a run, in journal order, and keeps them in memory."""

    trouble: str = ""
    """Reason why rows cannot be written now; empty when they can."""
    durable: int = 0
    """Number of durable rows of the run."""

    def __init__(self, shape: RowShape) -> None:
        self._shape = shape
        self._parts: list[Rows] = []
        self.platform: dict[str, str] = {}  # Platform of the rows; empty before a worker came

    @property
    def rows(self) -> Rows:
        """All rows kept, in journal order."""
        return np.concatenate([self._shape.empty(0), *self._parts])

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Open the run; returns the epoch to use and the number of recorded rows.

        In epoch 0 a new one is issued. `wait` is called between two tries; it may raise to end them.
        """
        self._parts, self.durable = [], 0
        return Opened(epoch=1, durable=[0], platform={})

    def recorded_rows(self, first: int, wait: Callable[[], None]) -> JournalSlice:
        """Return recorded rows from number `first` on, some if there are any."""
        return JournalSlice(first, self._shape.empty(0))

    def push(self, part: JournalSlice) -> None:
        """Take rows that became final."""
        self._parts.append(part.rows)
        self.durable += len(part)

    def tick(self, now: float) -> None:
        """Send the messages that are due."""

    def on_report(self, message: Recorded, now: float) -> None:
        """Process a recorder's report."""

    def resend(self, now: float) -> None:
        """Send again the rows that are not durable: a recorder appeared."""

    @property
    def is_full(self) -> bool:
        """True if too many rows are unconfirmed to ask for more."""
        return False

    @property
    def is_empty(self) -> bool:
        """True if all rows taken are safe."""
        return True


MESSAGE_ROWS = 1024  # The most rows in one message
MOST_UNCONFIRMED = 20_000  # With more unconfirmed rows than this, the run stops asking
RESEND_AFTER = 2.0  # Seconds without progress after which everything unconfirmed is sent again
DOUBT_SECONDS = 3.0  # Seconds of hearing only lower numbers before they are believed: one may be late


class Outbox:
    """Unconfirmed rows of one run, of which `durable` rows were durable when it was opened."""

    def __init__(self, durable: int = 0) -> None:
        self.start(durable)

    def start(self, durable: int) -> None:
        """Begin behind so many durable rows, with none to send."""
        self.durable = durable
        self._kept: deque[JournalSlice] = deque()
        self._end = durable
        self._sent = durable
        self._progress = 0.0
        self._lower_since: float | None = None

    @property
    def unconfirmed(self) -> int:
        """Number of rows not known to be durable."""
        return self._end - self.durable

    @property
    def is_empty(self) -> bool:
        """True if all rows are durable."""
        return not self.unconfirmed

    @property
    def is_full(self) -> bool:
        """True if the run must stop asking until the recorder catches up."""
        return self.unconfirmed > MOST_UNCONFIRMED

    def push(self, part: JournalSlice) -> None:
        """Take the next rows of the journal."""
        if part.first != self._end:
            raise ValueError(f"row {self._end} was to be next, got {part.first}")
        if len(part):
            self._kept.append(part)
            self._end = part.stop

    def take_due(self, now: float) -> list[JournalSlice]:
        """Return the rows to be sent now, in slices, and count them as sent."""
        if self._is_waiting and now >= self._progress + RESEND_AFTER:
            self.resend(now)
        if self._sent == self._end:
            return []
        if not self._is_waiting:
            self._progress = now
        parts = [kept.part(self._sent, self._end) for kept in self._kept if kept.stop > self._sent]
        rest = join_slices(parts)
        self._sent = self._end
        firsts = range(rest.first, rest.stop, MESSAGE_ROWS)
        return [rest.part(first, first + MESSAGE_ROWS) for first in firsts]

    def confirm(self, number: int, now: float) -> None:
        """Record that `number` rows are durable.

        Raises RecorderFellBack if the recorder has fewer rows than it reported before, or more than were ever
        sent. A lower number may also have been overtaken by a higher one on its way, so it is believed only
        when nothing else was reported for `DOUBT_SECONDS`.
        """
        # Lower numbers come late now and then; for seconds alone they say that a disk was restored.
        if number < self.durable or number > self._end:
            if self._lower_since is None:
                self._lower_since = now
            elif now >= self._lower_since + DOUBT_SECONDS:
                raise RecorderFellBack(number, self.durable, self._end)
            return
        self._lower_since = None
        if number > self.durable:
            self._progress = now
            self._forget(number)

    def resend(self, now: float) -> None:
        """Have all unconfirmed rows sent again: a new recorder may have missed them."""
        self._sent = self.durable
        self._progress = now

    @property
    def _is_waiting(self) -> bool:
        return self._sent > self.durable

    def _forget(self, number: int) -> None:
        self.durable = number
        self._sent = max(self._sent, number)
        while self._kept and self._kept[0].stop <= number:
            self._kept.popleft()


SILENT_SECONDS = 10.0  # After which it is said that a recorder reports no rows
REPLAY_ROWS = 2048  # Rows in one page of a replay
ASK_TIMEOUT, MOST_ASK_TIMEOUT = 1.0, 10.0
"""Seconds that a request to a recorder waits, at first and at most.

A request on a lost link is lost; each wait in vain doubles the time, as a recorder may be slow.
"""


class RecorderClient(Outbox, RowSink):
    """The recorder at the other end of the bus (docs/bus.md, rule 8)."""

    def __init__(self, bus: Bus, job: str, shape: RowShape) -> None:
        Outbox.__init__(self)
        RowSink.__init__(self, shape)
        self._bus = bus
        self._keys = Keys(job)
        self._job = job
        self._run = ""
        self._epoch = 0
        self._heard = 0.0  # When a recorder reported last, or was to report nothing

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Ask the recorder to open the run, again and again until one answers.

        Raises InputError if it holds another run, TookOver if it answers another coordinator by now.
        """
        opened = self._open([run], epoch, wait)
        self._run, self._epoch = run.run, opened.epoch
        self.start(opened.durable[0])
        self.platform = opened.platform
        return opened

    def begin_epoch(self, wait: Callable[[], None]) -> Opened:
        """Ask for an epoch before the first run of a campaign is opened; raises as `open`."""
        return self._open([], 0, wait)

    def _open(self, runs: list[OpenRun], epoch: int, wait: Callable[[], None]) -> Opened:
        try:
            request = Open(job=self._job, runs=runs, epoch=epoch)
            return messages.decode(self._ask(self._keys.open, request, wait), Opened)
        except (Refused, Faulty) as refusal:
            _, is_over, other = str(refusal).partition(f"{TookOver.BY} ")
            if is_over:
                raise TookOver(self._job, other) from None
            raise InputError(f"The recorder does not open job '{self._job}': {refusal}.") from None

    def recorded_rows(self, first: int, wait: Callable[[], None]) -> JournalSlice:
        """Return a page of rows from the recorder's journal; InputError if it cannot read it."""
        try:
            request = Log(run=self._run, first=first, limit=REPLAY_ROWS)
            page = messages.decode(self._ask(self._keys.log, request, wait), Recordable)
        except (Refused, Faulty) as reason:
            raise InputError(f"The recorder does not show the rows of run '{self._run}': {reason}.") from None
        return slice_from_message(page, self._shape)

    def _ask(self, key: str, request: Message, wait: Callable[[], None]) -> bytes:
        """Ask until a recorder answers: one that died is started again."""
        patience = ASK_TIMEOUT
        while True:
            began = time.monotonic()
            try:
                answer = self._bus.ask(key, messages.encode(request), timeout=patience)
            except NoReply:
                if time.monotonic() >= began + patience:
                    patience = min(2 * patience, MOST_ASK_TIMEOUT)
                self.trouble = f"no recorder of job '{self._job}' answers, or its disk is full"
                wait()
            else:
                self.trouble = ""
                return answer

    def on_report(self, message: Recorded, now: float) -> None:
        """Note the number of durable rows."""
        if message.epoch > self._epoch > 0:
            raise TookOver(self._job, message.epoch)
        if message.run != self._run or message.epoch != self._epoch:
            return
        self.trouble, self._heard = message.trouble, now
        self.confirm(message.durable, now)

    def tick(self, now: float) -> None:
        """Send the rows that are due."""
        if not self._is_waiting:
            self._heard = now
        elif now >= self._heard + SILENT_SECONDS:
            self.trouble = f"the recorder of job '{self._job}' does not answer"
        key, kind = self._keys.outcome(self._epoch), messages.encoding(Recordable)
        for part in self.take_due(now):
            message = slice_to_message(part, self._run, self._epoch, self._shape, self.platform)
            self._bus.put(key, messages.encode(message), encoding=kind, channel=Channel.DATA)
