"""The overview of the jobs on a bus."""

from datetime import UTC, datetime

import pytest

from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, to_json
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.watching.overview import views
from qdgrasp_protocol.keys import Keys

NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
NOW = datetime(2026, 11, 22, 13, 2, 3, tzinfo=UTC)


def meta(job: str = "mugs", runs: int = 3) -> JobMeta:
    return JobMeta(job=job, epoch=2, since=NOON, host="head", pid=7, version="0", runs=runs, budget=3000)


def figures(**more: object) -> JobFigures:
    counts = dict.fromkeys(
        ("runs_done", "runs_failed", "simulated", "proposals", "overlaps", "dead_ends", "successes",
         "grasps", "robust", "errors"), 0
    )  # fmt: skip
    values = {"job": "mugs", "runs": 3, "runs_open": 2, "evaluations": 1000, "budget": 3000, "cells": 5}
    return JobFigures(**(counts | values | {"workers": 9, "seconds": 10.0, "rate": 100.0} | more))


def run(name: str) -> Figures:
    counts = dict.fromkeys(
        ("rows", "simulated", "proposals", "overlaps", "dead_ends", "successes", "grasps", "robust"), 0
    )
    more = {"errors": 0, "cells": 0, "workers": 9, "durable": 0, "seconds": 1.0, "rate": 1.0}
    what = {"gripper": "panda", "object": "mug", "method": "spare", "protocol": "paper", "seed": 0}
    rest = {"scene": "ab" * 32, "trials": 0, "outcomes": {}}
    return Figures(run=name, evaluations=10, budget=1000, **what, **rest, **counts, **more)


def worker(number: int) -> WorkerFigures:
    state = "idle" if number % 2 else "working"
    return WorkerFigures(
        wid=f"{number:032x}", host=f"n{number % 7}", pid=1, state=state, batches=0, rows=0, rate=0.0,
        seconds=1.0, seen=0.0, memory=0, restarts=0,
    )  # fmt: skip


def values(job: str = "mugs", runs: int = 3, workers: int = 9, **more: object) -> dict[str, bytes]:
    keys = Keys(job)
    shown = {keys.meta: meta(job, runs), keys.stat("job"): figures(job=job, runs=runs, **more)}
    shown |= {keys.stat(f"run/{name}"): run(name) for name in ("a", "b")}
    shown |= {keys.stat(f"worker/{one.wid}"): one for one in map(worker, range(workers))}
    return {key: to_json(value) for key, value in shown.items()}


def text(shown: dict[str, bytes]) -> str:
    return "\n".join(line for view in views(shown) for line in view.lines(NOW))


def test_a_job_is_told_in_a_few_lines() -> None:
    assert text(values(recorders=1)) == (
        "mugs: running on head (process 7, epoch 2) for 1 d 1:02:03\n"
        "  0 of 3 runs, 1000 of 3000 evaluations, 100/s, 0 successes in 5 cells, "
        "0 simulated of 0 proposals, 0 overlaps, 0 dead ends, 9 workers, 00:20 left\n"
        "  2 runs in progress: a 10/1000, b 10/1000\n"
        "  workers: n0 2, n1 2, n2 1, n3 1, n4 1, n5 1 and 1 more (4 idle, 5 working)"
    )


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"recorders": 0}, "no recorder is there"),
        ({"workers": 0}, "workers: none has joined"),
        ({"state": "paused"}, "paused until `qdgrasp continue mugs`"),
        ({"trouble": "the disk is full"}, "paused: the disk is full"),
    ],
)
def test_what_keeps_a_job_from_going_on_is_told(more: dict[str, object], words: str) -> None:
    assert words in text(values(**more))


def test_jobs_are_told_by_name_and_values_of_others_are_left_out() -> None:
    shown = values("mugs") | values("cubes") | {"qdgrasp/v1/odd/meta": b"[]", "else/where": b"{}"}
    shown[Keys("mugs").stat("run/a")] = b"not JSON"
    assert [(view.meta.job, len(view.runs)) for view in views(shown)] == [("cubes", 2), ("mugs", 1)]


@pytest.mark.parametrize("since", [b"yesterday", b"2026-11-21T12:00:00", b"9999-99-99T00:00:00Z"])
def test_a_job_that_began_at_no_time_is_left_out(since: bytes) -> None:
    shown, key = values("mugs"), Keys("mugs").meta
    shown[key] = shown[key].replace(b"2026-11-21T12:00:00Z", since)
    assert since in shown[key]
    assert views(shown) == []
