"""A monitor that hears what a coordinator says, told by hand."""

from collections.abc import Mapping

from msgspec import Struct
from tests.coordinator.monitor.shown import values

from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.monitor.jobs import Jobs, JobView
from qdgrasp_protocol.keys import Keys

MUGS = Keys("mugs")
START = 1000.0


def told(jobs: Jobs, now: float, **shown: Struct) -> None:
    """Let jobs hear something of the job mugs: `stat_run_a=...` on stat/run/a."""
    for place, struct in shown.items():
        jobs.heard(f"{MUGS.root}/{place.replace('_', '/')}", to_json(struct), now)


def watching(now: float = START, answers: Mapping[str, bytes] | None = None) -> Jobs:
    """A monitor that has asked, and was answered."""
    jobs = Jobs()
    jobs.questions(now)
    jobs.token(MUGS.coordinator_token(2), True, now)
    jobs.questions(now)
    jobs.answered(values() if answers is None else answers, now)
    jobs.questions(now)
    return jobs


def seen(jobs: Jobs, now: float) -> JobView:
    (view,) = jobs.views(now)
    return view
