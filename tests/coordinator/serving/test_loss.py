"""How soon a worker that is lost is shown as gone: by the coordinator's own loop, on a clock of the test."""

from collections.abc import Callable
from contextlib import ExitStack
from types import SimpleNamespace

import pytest
from tests.coordinator.recording.recorded import JOB
from tests.coordinator.runs.plans import Plan
from tests.coordinator.serving.served import PLATFORM, Job

from qdgrasp_coordinator.counts.figures import from_json
from qdgrasp_coordinator.counts.team import TeamFigures
from qdgrasp_coordinator.serving import service
from qdgrasp_coordinator.serving.board import INTERVAL
from qdgrasp_coordinator.serving.inbox import Event, Inbox, JoinRequest
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Join

KEYS = Keys(JOB)
ANN = "a" * 32
LONG = Plan(population=40, evaluations=100_000)


class Clock(Inbox):
    """An inbox whose waiting is all the time that passes, and what happens when.

    Until the first run is open, which takes another thread some time, none does.
    """

    def __init__(self, now: float) -> None:
        super().__init__()
        self.now = self.began = now
        self.happens: list[tuple[float, Callable[[], object]]] = []
        self.is_running: Callable[[], bool] = lambda: False

    def take(self, patience: float, most: int = 256) -> list[Event]:
        if not self.is_running():
            return super().take(min(patience, 0.01), most)
        events = super().take(0.0, most)
        if events:
            return events
        self.now += patience
        if self.happens and self.happens[0][0] <= self.now - self.began:
            after, act = self.happens.pop(0)
            self.now = self.began + after
            act()
        return super().take(0.0, most)


def join() -> JoinRequest:
    return JoinRequest(
        Join(versions=[1], wid=ANN, number=1, credit=2, held=[], host="here", pid=1, platform=PLATFORM)
    )


@pytest.mark.parametrize("tenth", range(10))
def test_a_worker_whose_token_vanishes_is_shown_as_gone_within_half_a_second(
    tenth: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever that is in the second between two publications of the team."""
    clock, lost_after = Clock(now=1000.0), 5.0 + tenth / 10
    monkeypatch.setattr(service, "Inbox", lambda: clock)
    monkeypatch.setattr(service, "time", SimpleNamespace(monotonic=lambda: clock.now))
    job = Job({"run-0": LONG})
    states: list[tuple[float, list[str]]] = []

    def heard(sample: Sample) -> None:
        page = from_json(sample.payload, TeamFigures)
        states.append((clock.now - clock.began, [one.state for one in page.workers]))
        if states[-1][1] == ["gone"]:
            job.stop.set(15)

    with ExitStack() as stack, job.network.session() as monitor, job.network.session() as worker:
        stack.enter_context(monitor.subscribe(KEYS.stat("team/*"), heard))
        clock.is_running = lambda: bool(job.open and job.open[-1])
        clock.happens = [
            (0.0, lambda: stack.enter_context(worker.token(KEYS.worker_token(ANN)))),
            (0.1, lambda: clock.put(join())),
            (lost_after, worker.close),
        ]
        job.service.run(lambda now: job.open.append(job.service.figures(now).runs_open))
    assert ["working"] in [shown for at, shown in states if at < lost_after]
    assert states[-1][0] - lost_after <= INTERVAL + 1e-9
