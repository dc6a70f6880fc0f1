"""Status messages, views and screens of jobs, made by hand."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from msgspec import Struct

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.job_status import JobEvent, JobStatus, WorkersPage, WorkerStatus, to_json
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.job_model import JobModels, JobView
from qdgrasp_tools.monitor.terminal import ScreenState

NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
NOW = datetime(2026, 11, 22, 13, 2, 3, tzinfo=UTC)
COUNTS = (
    "simulated",
    "steps",
    "overlaps",
    "dead_ends",
    "successes",
    "grasps",
    "robust",
    "errors",
    "contact_niches",
)


def meta(job: str = "mugs", runs: int = 3, epoch: int = 2) -> job_status.JobMeta:
    who = {"host": "head", "pid": 7, "version": "0"}
    return job_status.JobMeta(job=job, epoch=epoch, since=NOON, runs=runs, budget=3000, **who)


def figures(**more: object) -> JobStatus:
    counts = dict.fromkeys(("runs_done", "runs_failed", "trials", *COUNTS), 0)
    values = {"job": "mugs", "runs": 3, "runs_open": 2, "evaluations": 1000, "budget": 3000, "cells": 5}
    values |= {"workers": 9, "seconds": 10.0, "rate": 100.0} | more
    remaining = max(0, values["budget"] - values["evaluations"])
    left = remaining / values["rate"] if values["rate"] else None
    return JobStatus(**(counts | {"remaining": remaining, "seconds_left": left} | values))


def run(name: str, **more: object) -> job_status.RunStatus:
    counts = dict.fromkeys(("rows", "trials", "cells", "durable", *COUNTS), 0)
    what = {"gripper": "panda", "object": "mug", "method": "portfolio", "protocol": "paper", "seed": 0}
    rest = {"scene": "ab" * 32, "outcomes": {one.name.lower(): 0 for one in Outcome}}
    values = {"run": name, "evaluations": 10, "budget": 1000, "workers": 9, "seconds": 1.0, "rate": 1.0}
    return job_status.RunStatus(**(counts | what | rest | values | more))


def worker(number: int, **more: object) -> WorkerStatus:
    state = "idle" if number % 2 else "working"
    values = {"wid": f"{number:032x}", "host": f"n{number % 7}", "pid": 1, "state": state}
    counts = {"batches": 0, "rows": 0, "rate": 0.0, "seconds": 1.0, "seen": 0.0, "memory": 0, "restarts": 0}
    return WorkerStatus(**(values | counts | more))


def event(number: int, words: str = "Something happened.", **more: object) -> JobEvent:
    at = NOON.replace(minute=number // 60, second=number % 60)
    return JobEvent(**({"number": number, "at": at, "kind": "job", "words": words} | more))


def team(*workers: WorkerStatus) -> list[WorkersPage]:
    size = job_status.WORKERS_PER_PAGE
    pages = [list(workers[first : first + size]) for first in range(0, len(workers), size)] or [[]]
    return [WorkersPage(page=n, pages=len(pages), workers=page) for n, page in enumerate(pages)]


def values(
    job: str = "mugs", runs: int = 3, workers: int = 9, epoch: int = 2, **more: object
) -> dict[str, bytes]:
    """All answers of a coordinator."""
    keys = Keys(job)
    shown = {keys.meta: meta(job, runs, epoch), keys.stat("job"): figures(job=job, runs=runs, **more)}
    shown |= {keys.stat(f"run/{name}"): run(name) for name in ("a", "b")}
    shown |= {keys.stat(f"team/{page.page}"): page for page in team(*map(worker, range(workers)))}
    return {key: to_json(value) for key, value in shown.items()}


def views(shown: dict[str, bytes]) -> list[JobView]:
    """Return the views of answers that have just come."""
    jobs = JobModels()
    jobs.receive_answers(shown, 100.0)
    return jobs.views(100.0)


MUGS = Keys("mugs")
START = 1000.0


def publish(jobs: JobModels, now: float, **shown: Struct) -> None:
    """Send messages of the job mugs to the models: `stat_run_a=...` on stat/run/a."""
    for place, struct in shown.items():
        jobs.receive(f"{MUGS.root}/{place.replace('_', '/')}", to_json(struct), now)


def watching(now: float = START, answers: Mapping[str, bytes] | None = None) -> JobModels:
    """A monitor whose queries were answered."""
    jobs = JobModels()
    jobs.due_queries(now)
    jobs.coordinator_changed(MUGS.coordinator_token(2), True, now)
    jobs.due_queries(now)
    jobs.receive_answers(values() if answers is None else answers, now)
    jobs.due_queries(now)
    return jobs


def view_of(jobs: JobModels, now: float) -> JobView:
    (view,) = jobs.views(now)
    return view


ENDPOINT = "tcp/127.0.0.1:7447"
BUSY = {"rate": 10.5, "batches": 2, "rows": 12_345, "seen": 0.4, "memory": 310_000_000}
WORKERS = [worker(n, host=f"node-{n % 7}", **BUSY) for n in range(30)]


def job(
    name: str = "mugs",
    runs: int = 1,
    workers: Sequence[WorkerStatus] = WORKERS,
    events: Sequence[JobEvent] = (),
    seconds: int = 300,
    later: float = 0.5,
    **more: object,
) -> JobView:
    """Return a job after so many seconds with 83 evaluations each, and silence `later` seconds."""
    jobs, keys = JobModels(), Keys(name)
    jobs.coordinator_changed(keys.coordinator_token(2), True, 1000.0)
    names = [f"panda-mug-portfolio-s{number}" for number in range(runs)]

    def send(what: str, struct: object) -> None:
        jobs.receive(f"{keys.root}/{what}", to_json(struct), 1000.0 + second)  # type: ignore[arg-type]

    for second in range(1, seconds + 1):
        found = 83 * second
        counts = {"evaluations": found, "successes": found // 9, "cells": found // 50, "robust": found // 30}
        all_counts = counts | {"grasps": found // 12, "simulated": found // 2, "overlaps": found // 3}
        rest = {"budget": 100_000, "seconds": float(second), "rate": 83.0, "recorders": 1}
        send("stat/job", figures(**({"job": name, "runs": runs} | all_counts | rest | more)))
        for one in names[: 2 if runs > 1 else 1]:
            send(f"stat/run/{one}", run(one, **counts))
    send("meta", meta(name, runs))
    for page in team(*workers):
        send(f"stat/team/{page.page}", page)
    for one in events or [event(n, f"Worker {n} joined.", kind="worker") for n in range(20)]:
        send(f"event/{one.kind}", one)
    (view,) = jobs.views(1000.0 + seconds + later)
    return view


def shown(*views: JobView, **more: object) -> ScreenState:
    return ScreenState(views, ENDPOINT, NOW, **more)  # type: ignore[arg-type]
