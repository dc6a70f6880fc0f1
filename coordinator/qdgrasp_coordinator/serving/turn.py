"""A coordinator's turn at a job: what it does with what it hears, decided without a thread or a clock.

Pipeline, dispatch and outbox decide for themselves; here stands who of them hears what, and what goes out
(docs/bus.md, rules 1 to 10). Time is passed in, in seconds of any steady clock.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from typing import Protocol

import structlog

from qdgrasp_coordinator.counts.figures import from_json
from qdgrasp_coordinator.dispatching.batch import Settlement, readable
from qdgrasp_coordinator.dispatching.dispatch import STRIKES, Dispatch
from qdgrasp_coordinator.folders.platforms import admit
from qdgrasp_coordinator.runs.generation import Generation
from qdgrasp_coordinator.serving.chronicle import Chronicle
from qdgrasp_coordinator.serving.crew import Crew, Put
from qdgrasp_coordinator.serving.inbox import JoinRequest, LinkChange, TokenChange
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_protocol.bus import Channel, Sample
from qdgrasp_protocol.codec import decoded
from qdgrasp_protocol.drops import Drops
from qdgrasp_protocol.errors import MessageError, TookOver
from qdgrasp_protocol.keys import Keys, last_chunk, number
from qdgrasp_protocol.messages import (
    Failure,
    Join,
    Opened,
    Recorded,
    Result,
)
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.sign import Sign

log = structlog.get_logger()

AHEAD_SECONDS = 2.0
"""Another run is wanted when less work than this waits for each worker."""


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
        self.crew = Crew(epoch, self._keys, self.dispatch, put, self._chronicle)
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
        crew = self.crew
        crew.platform = admit(crew.platform, opened.platform or crew.platform)
        lane.record.set_platform(crew.platform)

    def take(self, event: object, now: float) -> None:
        """Hear an event; what is none of ours is ignored.

        Raises
        ------
        TookOver
            Another coordinator took over.
        """
        match event:
            case JoinRequest(join, answer):
                self._take_join(join, answer, now)
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
                self.crew.said(last_chunk(sample.key), from_json(sample.payload, Sign), now)
        except MessageError as error:
            self.drops.note(sample.key, error)

    def _take_token(self, key: str, alive: bool, now: float) -> None:
        who = last_chunk(key)
        if key == self._keys.worker_token(who):
            self.crew.token_changed(who, alive, now)
        elif key == self._keys.recorder_token(who):
            for lane in self._lanes if alive else ():
                lane.record.recorder_up(now)
        elif alive and (number(who) or 0) > self.epoch:
            raise TookOver(self._job, who)

    def _take_join(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join; the first one tells the platform of the rows."""
        known = self.crew.platform
        self.crew.join(join, answer, now)
        for lane in self._lanes if self.crew.platform != known else ():
            lane.record.set_platform(self.crew.platform)

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
            self.crew.drop(settled.superseded, [result.batch])
        if settled.kind is Settlement.FRESH and settled.rows is not None:
            self.crew.settled(wid, result.n, now)
            self._note_failures(lane.run, wid, settled.failures)
            lane.record.push(lane.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures))
            if lane.pipeline.finished is not None:
                self.withdraw(lane.run)

    def _note_failures(self, run: str, wid: str, failures: Sequence[Failure]) -> None:
        """Note that rows were given up."""
        if failures:
            rows = f"{counted(len(failures), 'row')} of run '{run}'"
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
            self.crew.lost(lost, now)
        for lane in self._lanes:
            self._move(lane, now)
        for lease in [] if self.is_paused or self.is_ending else self.dispatch.leases(now):
            self._put(self._keys.work(lease.wid), lease.work(self.epoch), Channel.DATA)

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

    # It ends, or some of its runs do.

    def end(self) -> None:
        """Ask and lease nothing any more, and take back what is out; what was found is still recorded."""
        self.is_ending = True
        for lane in self._lanes:
            self.withdraw(lane.run)

    def withdraw(self, run: str) -> None:
        """Have nobody work on a run any more."""
        for wid, batches in self.dispatch.withdraw(run).items():
            self.crew.drop(wid, batches)
