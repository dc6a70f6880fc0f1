"""A simulated recorder: the real scribe and books, on a disk that outlives it."""

from collections.abc import Callable

from tests.simulation.network import Asked, Network
from tests.simulation.paper import FOLDER, Disk, PaperBooks
from tests.simulation.process import Busy, Life, Listen, Process
from tests.simulation.worker import JOB, KEYS
from tests.simulation.world import World

from qdgrasp_coordinator.recording.recorder import REST
from qdgrasp_coordinator.recording.scribe import Scribe
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Channel, Sample
from qdgrasp_protocol.errors import DiskFull, NoReply, Refused
from qdgrasp_protocol.messages import Recorded

PATIENCE = 60.0
"""How long a full disk is waited for [s]."""


class Recorder(Process):
    """A recorder process.

    Parameters
    ----------
    disk
        What it writes on, when nobody else does.
    latency
        The mean time of a commit [s].
    opened
        Told when it keeps the books.
    reports
        Told of each report.
    """

    def __init__(
        self,
        world: World,
        network: Network,
        name: str,
        disk: Disk,
        latency: float,
        opened: Callable[[PaperBooks], None],
        reports: Callable[[Recorded], None],
    ) -> None:
        self._disk = disk
        self._latency = latency
        self._opened = opened
        self._reports = reports
        self._before: dict[str, int] | None = None
        self.scribe: Scribe | None = None
        self.books: PaperBooks | None = None
        super().__init__(world, network, name)

    def life(self) -> Life:
        """Wait for the lock of the folder, then record."""
        while self._disk.holder is not None:
            yield Busy(1.0)
        self._disk.holder = self
        self.books = PaperBooks(self._disk, JOB)
        self._opened(self.books)
        self.scribe = Scribe(self.books, JOB, FOLDER, PATIENCE, self.now)
        self.network.subscribe(self.session, KEYS.outcome())
        self.network.answer(self.session, KEYS.open)
        self.network.answer(self.session, KEYS.log)
        self.network.token(self.session, KEYS.recorder_token(self.name.replace(" ", "")))
        while True:
            yield Listen(max(0.0, min(self.scribe.deadline - self.now, REST)))
            yield from self._step(self.scribe)

    def hear(self, event: object) -> None:
        """Answer a question at once where nobody waits for it in between; see `Network.ask_now`."""
        if isinstance(event, Asked) and self.scribe is not None and self.is_running:
            self.world.touched.append(self)
            event.reply(self._answer(event, self.scribe))
        elif not isinstance(event, Asked):
            super().hear(event)

    def end(self, *, flushed: bool = True) -> None:
        """Die; a commit that was under way may not be on the disk."""
        if self._before is not None and not self.is_over and self.world.chance.random() < 0.5:
            self.note("a commit is lost")
            self._disk.cut(self._before)
        if self._disk.holder is self:
            self._disk.holder = None
        super().end(flushed=flushed)

    def _answer(self, asked: Asked, scribe: Scribe) -> bytes | Exception:
        if self._before is not None:
            return NoReply("it is busy")
        try:
            return scribe.answer(asked.query, self.now)
        except (NoReply, Refused) as reason:
            return reason
        except DiskFull:
            self.world.later(0.0, self.end)
            return NoReply("its disk is full")

    def _step(self, scribe: Scribe) -> Life:
        """Hear what came, commit what is due, and say so once it is on the disk."""
        for event in self.events():
            if isinstance(event, Sample):
                scribe.take(event, self.now)
        before = self._disk.counts()
        try:
            reports = scribe.step(self.now)
        except DiskFull:
            self.note("gives a full disk up")
            return
        if self._disk.counts() != before:
            self._before = before
            yield Busy(self.world.exponential(self._latency))
            self._before = None
        for report in reports:
            self._put(report)

    def _put(self, report: Recorded) -> None:
        self._reports(report)
        encoding = codec.encoding(Recorded)
        self.network.put(self.session, KEYS.recorded, codec.encode(report), encoding, Channel.CONTROL)
