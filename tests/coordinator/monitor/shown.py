"""What coordinators say of their jobs, made by hand."""

from datetime import UTC, datetime

from qdgrasp_coordinator.counts.curve import Curve, Point
from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, to_json
from qdgrasp_coordinator.counts.team import PAGE, TeamFigures, WorkerFigures
from qdgrasp_coordinator.monitor.jobs import Jobs, JobView
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.outcome import Outcome

NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
NOW = datetime(2026, 11, 22, 13, 2, 3, tzinfo=UTC)
COUNTS = ("simulated", "proposals", "overlaps", "dead_ends", "successes", "grasps", "robust", "errors")


def meta(job: str = "mugs", runs: int = 3, epoch: int = 2) -> JobMeta:
    return JobMeta(job=job, epoch=epoch, since=NOON, host="head", pid=7, version="0", runs=runs, budget=3000)


def figures(**more: object) -> JobFigures:
    counts = dict.fromkeys(("runs_done", "runs_failed", "trials", *COUNTS), 0)
    values = {"job": "mugs", "runs": 3, "runs_open": 2, "evaluations": 1000, "budget": 3000, "cells": 5}
    values |= {"workers": 9, "seconds": 10.0, "rate": 100.0} | more
    return JobFigures(**(counts | {"remaining": max(0, values["budget"] - values["evaluations"])} | values))


def run(name: str, **more: object) -> Figures:
    counts = dict.fromkeys(("rows", "trials", "cells", "durable", *COUNTS), 0)
    what = {"gripper": "panda", "object": "mug", "method": "aimed", "protocol": "paper", "seed": 0}
    rest = {"scene": "ab" * 32, "outcomes": {one.name.lower(): 0 for one in Outcome}}
    values = {"run": name, "evaluations": 10, "budget": 1000, "workers": 9, "seconds": 1.0, "rate": 1.0}
    return Figures(**(counts | what | rest | values | more))


def worker(number: int, **more: object) -> WorkerFigures:
    state = "idle" if number % 2 else "working"
    values = {"wid": f"{number:032x}", "host": f"n{number % 7}", "pid": 1, "state": state}
    counts = {"batches": 0, "rows": 0, "rate": 0.0, "seconds": 1.0, "seen": 0.0, "memory": 0, "restarts": 0}
    return WorkerFigures(**(values | counts | more))


def event(number: int, words: str = "Something happened.", **more: object) -> Event:
    at = NOON.replace(minute=number // 60, second=number % 60)
    return Event(**({"number": number, "at": at, "kind": "job", "words": words} | more))


def curve(name: str, *evaluations: int) -> Curve:
    return Curve(run=name, points=[Point(n, 4 * n, n // 2, n // 10, n // 4) for n in evaluations])


def team(*workers: WorkerFigures) -> list[TeamFigures]:
    pages = [list(workers[first : first + PAGE]) for first in range(0, len(workers), PAGE)] or [[]]
    return [TeamFigures(page=n, pages=len(pages), workers=page) for n, page in enumerate(pages)]


def values(
    job: str = "mugs", runs: int = 3, workers: int = 9, epoch: int = 2, **more: object
) -> dict[str, bytes]:
    """All that a coordinator answers."""
    keys = Keys(job)
    shown = {keys.meta: meta(job, runs, epoch), keys.stat("job"): figures(job=job, runs=runs, **more)}
    shown |= {keys.stat(f"run/{name}"): run(name) for name in ("a", "b")}
    shown |= {keys.stat(f"team/{page.page}"): page for page in team(*map(worker, range(workers)))}
    return {key: to_json(value) for key, value in shown.items()}


def views(shown: dict[str, bytes]) -> list[JobView]:
    """What is seen of answers that have just come."""
    jobs = Jobs()
    jobs.answered(shown, 100.0)
    return jobs.views(100.0)
