"""The board: what a coordinator shows of its job to whoever watches.

It is published now and then, and late comers are told what was published last (docs/bus.md, what is shown).
What that costs does not depend on how many watch, or ask.
"""

import os
import socket
import time
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, to_json
from qdgrasp_coordinator.serving.chronicle import Chronicle
from qdgrasp_coordinator.serving.display import Display
from qdgrasp_coordinator.serving.lanes import Lanes
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.keys import Keys, last_chunk

INTERVAL = 0.5  # seconds between two publications of the figures
TEAM_INTERVAL = 1.0  # seconds between two of the workers', unless somebody's state has changed


class Board:
    """What is shown of a job.

    Parameters
    ----------
    lanes
        Its runs.
    turn
        The coordinator's turn as it is now.
    clock
        The time for late comers [s].
    """

    def __init__(
        self,
        bus: Bus,
        job: str,
        lanes: Lanes,
        turn: Callable[[], Turn],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.chronicle = Chronicle(self._publish_event)
        """What has happened."""
        self.display = Display(self._curves, clock)
        """What late comers are told."""
        self.is_cancelled = False
        """Whether the job ends here, before it is done: somebody wants it, or its time is over."""
        self._bus = bus
        self._job = job
        self._keys = Keys(job)
        self._lanes = lanes
        self._turn = turn
        self._identity = ""
        self._since = datetime.now(UTC).replace(microsecond=0)
        self._recorders: set[str] = set()
        self.due = 0.0
        """When figures are to be published again."""
        self._team_due = 0.0
        self._states: list[str] = []
        self._obstacle = ""

    def token_changed(self, key: str, alive: bool) -> None:
        """Note whether a recorder is there."""
        who = last_chunk(key)
        if key == self._keys.recorder_token(who) and alive != (who in self._recorders):
            (self._recorders.add if alive else self._recorders.discard)(who)
            words = "A recorder is there." if alive else "The recorder is gone; what is found waits for one."
            self.chronicle.note("recorder", words)

    def figures(self, now: float) -> JobFigures:
        """How far the job is."""
        turn = self._turn()
        found = self._lanes.figures(self._job, turn.dispatch.workers, now)
        return msgspec.structs.replace(
            found,
            state="cancelled" if self.is_cancelled else state_of(turn),
            recorders=len(self._recorders),
            requeued=turn.dispatch.counters["requeued"],
            strays=turn.dispatch.strays,
        )

    def open(self, now: float) -> None:
        """Have something to show to whoever asks first."""
        self.display.fill(self._keys.meta, to_json(self._meta))
        self.publish(now)

    def publish_meta(self, identity: str) -> None:
        """Show what the job is: a coordinator begins its turn at the one that a recorder knows by this."""
        self._identity = identity
        self._put(self._keys.meta, self._meta)

    def publish_due(self, now: float) -> None:
        """Show how far everything is, if that was long enough ago."""
        if now >= self.due:
            self.publish(now)

    def publish(self, now: float) -> None:
        """Show how far everything is."""
        self.due = now + INTERVAL
        runs = [lane.figures(self._turn().dispatch.workers, now) for lane in self._lanes]
        self.display.keep(self._keys.stat("run/*"), {run.run for run in runs})
        for run in runs:
            self.publish_run(run)
        figures = self.figures(now)
        self._note_trouble(figures)
        self._put(self._keys.stat("job"), figures)
        self._publish_team(now)

    def publish_run(self, figures: Figures) -> None:
        """Show how far a run is."""
        self._put(self._keys.stat(f"run/{figures.run}"), figures)

    def _publish_team(self, now: float) -> None:
        """Show the workers, now and then, and when one is not as it was."""
        states = [f"{member.wid} {member.state}" for member in self._turn().dispatch.members]
        if now < self._team_due and states == self._states:
            return
        self._team_due, self._states = now + TEAM_INTERVAL, states
        pages = self._turn().crew.pages(now)
        self.display.keep(self._keys.stat("team/*"), {str(page.page) for page in pages})
        for page in pages:
            self._put(self._keys.stat(f"team/{page.page}"), page)

    def _publish_event(self, event: Event) -> None:
        self._send(self._keys.event(event.kind), to_json(event))
        self.display.fill(self._keys.recent, to_json(self.chronicle.latest))

    def _note_trouble(self, figures: JobFigures) -> None:
        """Note that trouble came, or went."""
        if figures.obstacle != self._obstacle:
            over = f"It goes on; this is over: {self._obstacle}"
            self.chronicle.note("trouble", figures.obstacle or over)
            self._obstacle = figures.obstacle

    @property
    def _meta(self) -> JobMeta:
        return JobMeta(
            job=self._job,
            epoch=self._turn().epoch,
            since=self._since,
            host=socket.gethostname(),
            pid=os.getpid(),
            version=version("qdgrasp"),
            runs=self._lanes.extent.runs,
            budget=self._lanes.extent.evaluations,
            identity=self._identity,
        )

    def _curves(self) -> dict[str, Curve]:
        """How the runs in progress grew; in any thread."""
        return {self._keys.stat(f"curve/{lane.run}"): lane.curve for lane in self._lanes}

    def _put(self, key: str, shown: Struct) -> None:
        """Show something to those who watch and to those who come late."""
        payload = to_json(shown)
        self.display.fill(key, payload)
        self._send(key, payload)

    def _send(self, key: str, payload: bytes) -> None:
        self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)


def state_of(turn: Turn) -> str:
    """What a coordinator is about in its turn, in a word."""
    states = {"ending": turn.is_ending, "paused": turn.is_paused, "starting": not turn.epoch}
    return next((state for state, holds in states.items() if holds), "running")
