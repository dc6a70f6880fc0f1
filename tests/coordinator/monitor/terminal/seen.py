"""Jobs to look at."""

from collections.abc import Sequence

from tests.coordinator.monitor.shown import NOW, event, figures, meta, run, team, worker

from qdgrasp_coordinator.counts.curve import Curve, Point
from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.monitor.jobs import Jobs, JobView
from qdgrasp_coordinator.monitor.terminal.frame import Shown
from qdgrasp_protocol.keys import Keys

ENDPOINT = "tcp/127.0.0.1:7447"
WORKERS = [
    worker(n, rate=10.5, batches=2, rows=12_345, seen=0.4, memory=310_000_000, host=f"node-{n % 7}")
    for n in range(30)
]


def job(
    name: str = "mugs",
    runs: int = 1,
    workers: Sequence[WorkerFigures] = WORKERS,
    events: Sequence[Event] = (),
    seconds: int = 300,
    later: float = 0.5,
    **more: object,
) -> JobView:
    """A job that goes on for so many seconds, 83 evaluations in each; nothing is heard of it later."""
    jobs, keys = Jobs(), Keys(name)
    jobs.token(keys.coordinator_token(2), True, 1000.0)
    names = [f"panda-mug-aimed-s{number}" for number in range(runs)]

    def heard(what: str, struct: object) -> None:
        jobs.heard(f"{keys.root}/{what}", to_json(struct), 1000.0 + second)  # type: ignore[arg-type]

    for second in range(1, seconds + 1):
        found = 83 * second
        counts = {"evaluations": found, "successes": found // 9, "cells": found // 50, "robust": found // 30}
        all_counts = counts | {"grasps": found // 12, "simulated": found // 2, "overlaps": found // 3}
        rest = {"budget": 100_000, "seconds": float(second), "rate": 83.0, "recorders": 1}
        heard("stat/job", figures(**({"job": name, "runs": runs} | all_counts | rest | more)))
        for one in names[: 2 if runs > 1 else 1]:
            heard(f"stat/run/{one}", run(one, **counts))
    heard("meta", meta(name, runs))
    for one in names[:1]:
        points = [Point(n, 4 * n, n // 9, n // 50, n // 30) for n in range(0, 83 * seconds, 83)]
        jobs.answered({keys.stat(f"curve/{one}"): to_json(Curve(run=one, points=points))}, 1000.0 + seconds)
    for page in team(*workers):
        heard(f"stat/team/{page.page}", page)
    for one in events or [event(n, f"Worker {n} joined.", kind="worker") for n in range(20)]:
        heard(f"event/{one.kind}", one)
    (view,) = jobs.views(1000.0 + seconds + later)
    return view


def shown(*views: JobView, **more: object) -> Shown:
    return Shown(views, ENDPOINT, NOW, **more)  # type: ignore[arg-type]
