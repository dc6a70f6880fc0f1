"""A job as it is shown: on a terminal, on the page, as metrics, as JSON."""

from msgspec import Struct

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.monitor.series import Series

OVER = ("gone", "ended", "cancelled")
"""The states of a job that nobody carries out."""


class JobView(Struct, frozen=True, kw_only=True):
    """What is known of a job now, and how that came to be."""

    job: str
    state: str
    """What its coordinator says: "starting", "running", "paused", "ending" or, at last, "cancelled".

    Where it says nothing: "silent" (nobody knows why: the router may be away), "gone" (it died) or "ended"
    (all runs are done, or failed).
    """
    silent: float
    """Seconds since its coordinator was heard."""
    meta: JobMeta
    figures: JobFigures
    runs: list[Figures]
    """Those in progress, and those that ended while somebody watched, in the order they were heard of."""
    workers: list[WorkerFigures]
    """Each once: on its way to another page one may stand on both."""
    events: list[Event]
    """The latest, eldest first."""
    history: Series
    """How the job went while somebody watched."""
    histories: dict[str, Series]
    """How its runs did, by their names."""
    curves: dict[str, Curve]
    """How the runs grew from their beginnings on, by their names."""

    def foremost(self, most: int) -> list[Figures]:
        """So many of its runs, in their order; left out are those that are over, then the silent ones."""

        def rank(number: int) -> tuple[bool, float, int]:
            run = self.runs[number]
            heard = self.histories[run.run].at[-1:] if run.run in self.histories else []
            return not run.finished, max(heard, default=0.0), number

        return [self.runs[number] for number in sorted(sorted(range(len(self.runs)), key=rank)[-most:])]


def last_word(figures: JobFigures | None) -> str:
    """How a job ended, where these figures are its last; empty where they are not."""
    if figures is None:
        return ""
    if figures.runs_done + figures.runs_failed >= figures.runs > 0:
        return "ended"
    return "cancelled" if figures.state == "cancelled" else ""
