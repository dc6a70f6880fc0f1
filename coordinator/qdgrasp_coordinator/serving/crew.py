"""The crew: the workers of one coordinator's turn, as they join, show signs of life, leave or are lost.

Who holds what is the dispatch's; time is passed in, in seconds of any steady clock.
"""

from collections.abc import Callable
from concurrent.futures import Future

import structlog

from qdgrasp_coordinator.counts.team import TeamFigures, WorkerFigures
from qdgrasp_coordinator.dispatching.dispatch import Dispatch, Lost
from qdgrasp_coordinator.folders.platforms import admit
from qdgrasp_coordinator.serving.chronicle import Chronicle
from qdgrasp_coordinator.serving.team import Team
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import VERSION, Control, Join, Joined, Message
from qdgrasp_protocol.sign import Sign

log = structlog.get_logger()

Put = Callable[[str, Message, Channel], None]
"""Sends a message on a key; what is sent while there is no link is lost."""


class Crew:
    """The workers, all of one platform.

    Parameters
    ----------
    epoch
        The turn's.
    dispatch
        Who of them holds what.
    put
        Sends messages.
    chronicle
        Where it is noted what happens to them.
    """

    def __init__(self, epoch: int, keys: Keys, dispatch: Dispatch, put: Put, chronicle: Chronicle) -> None:
        self.platform: dict[str, str] = {}
        """On which rows are made; empty before anybody has joined."""
        self.alive: set[str] = set()
        """Those whose tokens are there."""
        self._epoch = epoch
        self._keys = keys
        self._dispatch = dispatch
        self._put = put
        self._chronicle = chronicle
        self._team = Team()

    # They come and go.

    def join(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join."""
        try:
            self._admit(join)
        except Refused as refusal:
            words = f"A worker on {join.host} was refused: {refusal}."
            self._chronicle.note("worker", words, worker=join.wid)
            answer.set_exception(refusal)
            return
        drop = self._dispatch.join(join.wid, join.number, join.credit, join.held, now)
        if join.wid not in self.alive:
            self._dispatch.expect(join.wid, now)
        if self._team.joined(join, now):
            self._chronicle.note("worker", f"{self._team.words(join.wid)} joined.", worker=join.wid)
        if self._dispatch.is_drained(join.wid):
            self._send_away(join.wid)
        log.info("worker joined", worker=join.wid[:8], host=join.host, pid=join.pid)
        answer.set_result(codec.encode(Joined(epoch=self._epoch, drop=drop)))

    def _admit(self, join: Join) -> None:
        """Check that a worker speaks as this job does, and is of its platform."""
        if VERSION not in join.versions:
            spoken = f"it speaks versions {join.versions} of the protocol"
            raise Refused(f"{spoken}, this job speaks {VERSION}")
        self.platform = admit(self.platform, join.platform)

    def token_changed(self, wid: str, alive: bool, now: float) -> None:
        """Hear that a worker's token is there, or gone."""
        if alive:
            self.alive.add(wid)
            self._dispatch.back(wid, now)
        else:
            self.alive.discard(wid)
            self._dispatch.gone(wid, now)

    def lost(self, lost: Lost, now: float) -> None:
        """Note that a worker was given up: it is gone, as it wanted or not, or is stuck."""
        log.info("gave a worker up", worker=lost.wid[:8], reason=lost.reason, requeued=lost.batches)
        end = "is stuck" if lost.is_there else "is gone"
        how = "has left" if self._team.is_leaving(lost.wid) else f"{end}: {lost.reason}"
        again = f"; {lost.batches} of its batches are queued again" if lost.batches else ""
        words = f"{self._team.words(lost.wid)} {how}{again}."
        self._chronicle.note("worker", words, worker=lost.wid)
        if not lost.is_there:
            self._team.lost(lost.wid, now)

    # They work.

    def said(self, wid: str, sign: Sign, now: float) -> None:
        """Hear that a worker is there; only one whose simulator works keeps its leases by that."""
        self._team.said(wid, sign, now)
        if sign.progressed:
            self._dispatch.seen(wid, now)

    def settled(self, wid: str, rows: int, now: float) -> None:
        """Note that a worker has settled rows."""
        self._team.settled(wid, rows, now)

    # They are told what to leave, and shown.

    def drain(self, wid: str) -> None:
        """Have a worker finish what it holds, and leave."""
        self._dispatch.drain(wid)
        self._send_away(wid)

    def drop(self, wid: str, batches: list[bytes]) -> None:
        """Take batches back from a worker."""
        self._put(self._keys.ctl(wid), Control(epoch=self._epoch, drop=batches), Channel.CONTROL)

    def _send_away(self, wid: str) -> None:
        self._put(self._keys.ctl(wid), Control(epoch=self._epoch, drain=True), Channel.CONTROL)

    def figures(self, now: float) -> list[WorkerFigures]:
        """Those that are there, in the order in which they joined."""
        return self._team.figures(self._dispatch.members, now)

    def pages(self, now: float) -> list[TeamFigures]:
        """All page by page, also those that have gone a short while ago."""
        return self._team.pages(self._dispatch.members, now)
