"""The board: what a coordinator shows of its job to whoever watches.

It is published now and then, and late comers ask for it as it is now (docs/bus.md, what is shown).
"""

import os
import socket
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version

import msgspec

from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, to_json
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.serving.lanes import Lanes
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.keys import Keys, last_chunk

INTERVAL = 0.5  # seconds between two publications of the figures


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
        self._bus = bus
        self._job = job
        self._keys = Keys(job)
        self._lanes = lanes
        self._turn = turn
        self._since = datetime.now(UTC).replace(microsecond=0)
        self._recorders: set[str] = set()
        self._due = 0.0

    def token_changed(self, key: str, alive: bool) -> None:
        """Note whether a recorder is there."""
        who = last_chunk(key)
        if key == self._keys.recorder_token(who):
            (self._recorders.add if alive else self._recorders.discard)(who)

    def figures(self, now: float) -> JobFigures:
        """How far the job is."""
        turn = self._turn()
        found = self._lanes.figures(self._job, turn.dispatch.workers, now)
        return msgspec.structs.replace(found, state=state_of(turn), recorders=len(self._recorders))

    def values(self, now: float) -> dict[str, bytes]:
        """All that is shown, by key."""
        stat, workers = self._keys.stat, self._turn().workers(now)
        shown: dict[str, Figures | JobFigures | WorkerFigures | JobMeta]
        shown = {self._keys.meta: self._meta, stat("job"): self.figures(now)}
        shown |= {stat(f"run/{one.run}"): one for one in self._runs(now)}
        shown |= {stat(f"worker/{one.wid}"): one for one in workers}
        return {key: to_json(value) for key, value in shown.items()}

    def publish_meta(self) -> None:
        """Show what the job is: a coordinator begins its turn."""
        self._put(self._keys.meta, to_json(self._meta))

    def publish_due(self, now: float) -> None:
        """Show how far everything is, if that was long enough ago."""
        if now >= self._due:
            self.publish(now)

    def publish(self, now: float) -> None:
        """Show how far everything is."""
        self._due = now + INTERVAL
        for figures in self._runs(now):
            self.publish_run(figures)
        self._put(self._keys.stat("job"), to_json(self.figures(now)))

    def publish_run(self, figures: Figures) -> None:
        """Show how far a run is."""
        self._put(self._keys.stat(f"run/{figures.run}"), to_json(figures))

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

    def _put(self, key: str, payload: bytes) -> None:
        self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)


def state_of(turn: Turn) -> str:
    """What a coordinator is about in its turn, in a word."""
    states = {"ending": turn.is_ending, "paused": turn.is_paused, "starting": not turn.epoch}
    return next((state for state, holds in states.items() if holds), "running")
