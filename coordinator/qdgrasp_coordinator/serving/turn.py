"""A coordinator's turn at a job: what it does with what it hears, decided without a thread or a clock.

Pipeline, dispatch and outbox decide for themselves; here stands who of them hears what, and what goes out
(docs/bus.md, rules 1 to 10). Time is passed in, in seconds of any steady clock.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Protocol

import structlog

from qdgrasp_coordinator.counts.figures import from_json
from qdgrasp_coordinator.counts.team import TeamFigures, WorkerFigures
from qdgrasp_coordinator.dispatching.batch import Settlement, readable
from qdgrasp_coordinator.dispatching.dispatch import STRIKES, Dispatch, Lost
from qdgrasp_coordinator.folders.platforms import admit
from qdgrasp_coordinator.runs.generation import Generation
from qdgrasp_coordinator.serving.chronicle import Chronicle
from qdgrasp_coordinator.serving.inbox import JoinRequest, LinkChange, TokenChange
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.team import Team
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Channel, Sample
from qdgrasp_protocol.codec import decoded
from qdgrasp_protocol.drops import Drops
from qdgrasp_protocol.errors import MessageError, Refused, TookOver
from qdgrasp_protocol.keys import Keys, last_chunk, number
from qdgrasp_protocol.messages import (
    VERSION,
    Control,
    Failure,
    Join,
    Joined,
    Message,
    Opened,
    Recorded,
    Result,
)
from qdgrasp_protocol.sign import Sign

log = structlog.get_logger()

AHEAD_SECONDS = 2.0
"""Another run is wanted when less work than this waits for each worker."""

Put = Callable[[str, Message, Channel], None]
"""Sends a message on a key; what is sent while there is no link is lost."""


class OpenLanes(Protocol):
    """The runs that are carried out now."""

    def __iter__(self) -> Iterator[Lane]:
        """All of them, eldest first."""

    def get(self, run: str) -> Lane | None:
        """That of a run; None where it is not open."""


class Turn:
    """What one coordinator does at a job, from its first open run to its end.

    Parameters
    ----------
    epoch
        Which turn it is; 0: none has begun, and nobody is served.
    lanes
        The open runs.
    put
        Sends messages.
    batch_size
        Rows in a batch; None: measured.
    chronicle
        Where it is noted what happens to workers and rows; None: nowhere that anybody looks.
    """

    def __init__(
        self,
        job: str,
        epoch: int,
        lanes: OpenLanes,
        put: Put,
        batch_size: int | None,
        chronicle: Chronicle | None = None,
    ) -> None:
        self.epoch = epoch
        self.dispatch = Dispatch(epoch, batch_size)
        self._job = job
        self._keys = Keys(job)
        self._results = self._keys.result("")
        self._lanes = lanes
        self._put = put
        self._chronicle = chronicle or Chronicle()
        self._team = Team()
        self._platform: dict[str, str] = {}
        self._alive: set[str] = set()
        self.drops = Drops()
        self.is_paused = False
        """Nothing is leased; what is out comes back and counts."""
        self.is_ending = False
        """Nothing is asked or leased any more; what was found is still recorded."""

    # Events come in.

    def begin(self, lane: Lane, opened: Opened) -> None:
        """Check that a run may be carried out beside the others, and note the platform of its rows.

        Raises
        ------
        Refused
            Its rows were made on another platform.
        """
        self._platform = admit(self._platform, opened.platform or self._platform)
        lane.record.set_platform(self._platform)

    def take(self, event: object, now: float) -> None:
        """Hear an event; what is none of ours is ignored.

        Raises
        ------
        TookOver
            Another coordinator took over.
        """
        match event:
            case JoinRequest(join, answer):
                self._admit(join, answer, now)
            case TokenChange(key, alive):
                self._take_token(key, alive, now)
            case LinkChange(up):
                self.dispatch.link(up, now)
            case Sample():
                self._take_sample(event, now)

    def _take_sample(self, sample: Sample, now: float) -> None:
        """Hear a message; what it may be is decided by its key, which is what access lists go by."""
        try:
            if sample.key == self._keys.recorded:
                self._take_recorded(decoded(sample, Recorded), now)
            elif sample.key.startswith(self._results):
                self._take_result(sample, now)
            else:
                self._take_sign(last_chunk(sample.key), from_json(sample.payload, Sign), now)
        except MessageError as error:
            self.drops.note(sample.key, error)

    def _take_token(self, key: str, alive: bool, now: float) -> None:
        who = last_chunk(key)
        if key == self._keys.worker_token(who):
            if alive:
                self._alive.add(who)
                self.dispatch.back(who, now)
            else:
                self._alive.discard(who)
                self.dispatch.gone(who, now)
        elif key == self._keys.recorder_token(who):
            for lane in self._lanes if alive else ():
                lane.record.recorder_up(now)
        elif alive and (number(who) or 0) > self.epoch:
            raise TookOver(self._job, who)

    def _admit(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join."""
        try:
            if VERSION not in join.versions:
                raise Refused(
                    f"it speaks versions {join.versions} of the protocol, this job speaks {VERSION}"
                )
            known = self._platform
            self._platform = admit(known, join.platform)
        except Refused as refusal:
            self._chronicle.note(
                "worker", f"A worker on {join.host} was refused: {refusal}.", worker=join.wid
            )
            answer.set_exception(refusal)
            return
        for lane in self._lanes if not known else ():
            lane.record.set_platform(self._platform)
        drop = self.dispatch.join(join.wid, join.number, join.credit, join.held, now)
        if join.wid not in self._alive:
            self.dispatch.expect(join.wid, now)
        if self._team.joined(join, now):
            self._chronicle.note("worker", f"{self._team.words(join.wid)} joined.", worker=join.wid)
        if self.dispatch.is_drained(join.wid):
            self._put(self._keys.ctl(join.wid), Control(epoch=self.epoch, drain=True), Channel.CONTROL)
        log.info("worker joined", worker=join.wid[:8], host=join.host, pid=join.pid)
        answer.set_result(codec.encode(Joined(epoch=self.epoch, drop=drop)))

    def _take_result(self, sample: Sample, now: float) -> None:
        """Settle a result once, and take what became final."""
        result, wid = decoded(sample, Result), last_chunk(sample.key)
        lane = self._lanes.get(result.run)
        if lane is None:
            self.dispatch.seen(wid, now)
            return
        result, rows = readable(result, lane.assignment.shape)
        settled = self.dispatch.settle(wid, result, rows, now)
        if settled.superseded is not None:
            self._drop(settled.superseded, [result.batch])
        if settled.kind is Settlement.FRESH and settled.rows is not None:
            self._team.settled(wid, result.n, now)
            self._note_failures(lane.run, wid, settled.failures)
            lane.record.push(lane.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures))
            if lane.pipeline.finished is not None:
                self.withdraw(lane.run)

    def _take_sign(self, wid: str, sign: Sign, now: float) -> None:
        """Hear that a worker is there; only one whose simulator works keeps its leases by that."""
        self._team.said(wid, sign, now)
        if sign.progressed:
            self.dispatch.seen(wid, now)

    def _note_failures(self, run: str, wid: str, failures: Sequence[Failure]) -> None:
        """Note that rows were given up."""
        if failures:
            rows = f"{len(failures)} row{'s' if len(failures) > 1 else ''} of run '{run}'"
            words = f"{rows} given up after {STRIKES} tries: {failures[0].reason}."
            self._chronicle.note("error", words, run=run, worker=wid)

    def _take_recorded(self, report: Recorded, now: float) -> None:
        lane = self._lanes.get(report.run)
        if lane is not None:
            lane.record.heard(report, now)

    # What can be done now is done.

    def step(self, now: float) -> None:
        """Give up who is overdue, ask what may be asked, send what was found, and lease what waits."""
        for lost in self.dispatch.tick(now):
            log.info("gave a worker up", worker=lost.wid[:8], reason=lost.reason, requeued=lost.batches)
            self._lost(lost, now)
        for lane in self._lanes:
            self._move(lane, now)
        for lease in [] if self.is_paused or self.is_ending else self.dispatch.leases(now):
            self._put(self._keys.work(lease.wid), lease.work(self.epoch), Channel.DATA)

    def _lost(self, lost: Lost, now: float) -> None:
        """Note that a worker was given up: it is gone, as it wanted or not, or is stuck."""
        end = "is stuck" if lost.is_there else "is gone"
        how = "has left" if self._team.is_leaving(lost.wid) else f"{end}: {lost.reason}"
        again = f"; {lost.batches} of its batches are queued again" if lost.batches else ""
        words = f"{self._team.words(lost.wid)} {how}{again}."
        self._chronicle.note("worker", words, worker=lost.wid)
        if not lost.is_there:
            self._team.lost(lost.wid, now)

    def next_deadline(self) -> float:
        """When `step` gives somebody up if nothing happens before; infinite: never."""
        return self.dispatch.next_deadline()

    @property
    def wants_more(self) -> bool:
        """Whether so little work waits that another run should be opened."""
        return not self.is_ending and self.dispatch.queued_seconds < AHEAD_SECONDS * self.dispatch.workers

    def _move(self, lane: Lane, now: float) -> None:
        """Ask what may be asked of a run, unless the recorder is far behind; send what it has found."""
        while self._may_ask(lane) and (generation := lane.pipeline.ask()) is not None:
            self._submit(lane, generation)
        lane.record.tick(now)

    def _may_ask(self, lane: Lane) -> bool:
        return not (self.is_ending or lane.record.is_full)

    def _submit(self, lane: Lane, generation: Generation) -> None:
        self.dispatch.submit(
            lane.run,
            lane.assignment.bundle.digest,
            lane.assignment.prior,
            generation.number,
            generation.indices,
            generation.trials,
            generation.genomes,
        )

    # Those who administer the job are obeyed.

    def workers(self, now: float) -> list[WorkerFigures]:
        """The workers, in the order in which they joined."""
        return self._team.figures(self.dispatch.members, now)

    def team(self, now: float) -> list[TeamFigures]:
        """The workers page by page, also those that have gone a short while ago."""
        return self._team.pages(self.dispatch.members, now)

    def drain(self, wid: str) -> None:
        """Have a worker finish what it holds, and leave."""
        self.dispatch.drain(wid)
        self._put(self._keys.ctl(wid), Control(epoch=self.epoch, drain=True), Channel.CONTROL)

    def end(self) -> None:
        """Ask and lease nothing any more, and take back what is out; what was found is still recorded."""
        self.is_ending = True
        for lane in self._lanes:
            self.withdraw(lane.run)

    def withdraw(self, run: str) -> None:
        """Have nobody work on a run any more."""
        for wid, batches in self.dispatch.withdraw(run).items():
            self._drop(wid, batches)

    def _drop(self, wid: str, batches: list[bytes]) -> None:
        """Take batches back from a worker."""
        self._put(self._keys.ctl(wid), Control(epoch=self.epoch, drop=batches), Channel.CONTROL)
