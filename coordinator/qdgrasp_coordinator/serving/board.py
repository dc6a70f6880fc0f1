"""The board: what a coordinator shows of its job to whoever watches.

It is published now and then, and late comers ask for it as it is now (docs/bus.md, what is shown). What that
costs does not depend on how many watch.
"""

import os
import socket
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, to_json
from qdgrasp_coordinator.counts.team import TeamFigures
from qdgrasp_coordinator.serving.chronicle import Chronicle
from qdgrasp_coordinator.serving.lanes import Lanes
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.keys import Keys, last_chunk, meet

INTERVAL = 0.5  # seconds between two publications of the figures
TEAM_INTERVAL = 1.0  # seconds between two of the workers', unless somebody's state has changed

Shown = Mapping[str, Struct]
"""What is shown, by key."""


class Board:
    """What is shown of a job.

    Parameters
    ----------
    lanes
        Its runs.
    turn
        The coordinator's turn as it is now.
    """

    def __init__(self, bus: Bus, job: str, lanes: Lanes, turn: Callable[[], Turn]) -> None:
        self.chronicle = Chronicle(self._publish_event)
        """What has happened."""
        self.is_cancelled = False
        """Whether the job ends here, before it is done: somebody wants it, or its time is over."""
        self._bus = bus
        self._job = job
        self._keys = Keys(job)
        self._lanes = lanes
        self._turn = turn
        self._since = datetime.now(UTC).replace(microsecond=0)
        self._recorders: set[str] = set()
        self._due = self._team_due = 0.0
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

    # Late comers ask.

    def values(self, asked: str, now: float) -> dict[str, bytes]:
        """What is shown on keys that match a pattern, as it is now; curves only where they are asked for."""
        stat = self._keys.stat
        sources: dict[str, Callable[[float], Shown]] = {
            self._keys.meta: lambda _now: {self._keys.meta: self._meta},
            self._keys.recent: lambda _now: {self._keys.recent: self.chronicle.latest},
            stat("job"): lambda now: {stat("job"): self.figures(now)},
            stat("run/*"): lambda now: {stat(f"run/{one.run}"): one for one in self._runs(now)},
            stat("team/*"): lambda now: {stat(f"team/{one.page}"): one for one in self._turn().team(now)},
            stat("curve/*"): lambda _now: {
                stat(f"curve/{lane.run}"): lane.curve for lane in self._lanes if "/curve/" in asked
            },
        }
        found = [show(now) for pattern, show in sources.items() if meet(asked, pattern)]
        return {key: to_json(value) for shown in found for key, value in shown.items() if meet(asked, key)}

    # Whoever watches hears.

    def publish_meta(self) -> None:
        """Show what the job is: a coordinator begins its turn."""
        self._put(self._keys.meta, self._meta)

    def publish_due(self, now: float) -> None:
        """Show how far everything is, if that was long enough ago."""
        if now >= self._due:
            self.publish(now)

    def publish(self, now: float) -> None:
        """Show how far everything is."""
        self._due = now + INTERVAL
        for run in self._runs(now):
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
        pages: list[TeamFigures] = []
        states = [f"{member.wid} {member.state}" for member in self._turn().dispatch.members]
        if now >= self._team_due or states != self._states:
            self._team_due, self._states = now + TEAM_INTERVAL, states
            pages = self._turn().team(now)
        for page in pages:
            self._put(self._keys.stat(f"team/{page.page}"), page)

    def _publish_event(self, event: Event) -> None:
        self._put(self._keys.event(event.kind), event)

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
        )

    def _runs(self, now: float) -> list[Figures]:
        return [lane.figures(self._turn().dispatch.workers, now) for lane in self._lanes]

    def _put(self, key: str, shown: Struct) -> None:
        self._bus.put(key, to_json(shown), encoding="application/json", channel=Channel.MONITOR)


def state_of(turn: Turn) -> str:
    """What a coordinator is about in its turn, in a word."""
    states = {"ending": turn.is_ending, "paused": turn.is_paused, "starting": not turn.epoch}
    return next((state for state, holds in states.items() if holds), "running")
