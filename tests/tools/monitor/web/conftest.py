"""Jobs, finds and records made by hand, and a server of the page with these behind it."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from queue import Queue
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import ArrayLike
from starlette.routing import BaseRoute
from starlette.testclient import TestClient
from tests import browser
from tests.common import PATIENCE, free_port
from tests.coordinator.scenes import made_scene
from tests.tools.monitor import sample_jobs

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.job_status import (
    JobEvent,
    ObjectListings,
    RunListings,
    RunStatus,
    WorkerStatus,
    to_json,
)
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_coordinator.storage.success_pages import SuccessTable, success_dtype
from qdgrasp_protocol.errors import NoReply, UnknownName
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.job_model import JobModels, JobView
from qdgrasp_tools.monitor.records import JournalId, RecordPage
from qdgrasp_tools.monitor.web.run_cache import JobCaches
from qdgrasp_tools.monitor.web.server import Access, application, live_routes, serve

HERE = "127.0.0.1"
BUDGET = 90_000
STEP = 60
COUNTS = ("evaluations", "successes", "cells", "contact_niches", "grasps", "robust", "simulated", "overlaps")


class FakeFeed:
    """A single run `mug`, and a job `hands` of six, or of three for each of so many seeds."""

    def __init__(self, seeds: int = 2) -> None:
        self.seeds = seeds
        self.now = time.time()
        self.jobs = JobModels()
        self.steps = 0
        self.gone: set[int] = set()
        self.lock = threading.Lock()

    @property
    def is_linked(self) -> bool:
        return self.jobs.is_linked

    def views(self) -> list[JobView]:
        with self.lock:
            return self.jobs.views(self.now)

    def step(self, at: float | None = None) -> "FakeFeed":
        """Go on by some evaluations."""
        self.steps += 1
        with self.lock:
            self.now = time.time()
            at = self.now if at is None else at
            self.jobs.receive_answers(_values("mug", ["mug"], self.steps, self.gone, at), at)
            names = [
                f"panda-{what}-portfolio-s{seed}"
                for what in ("mug", "drill", "banana")
                for seed in range(self.seeds)
            ]
            self.jobs.receive_answers(_values("hands", names, self.steps, set(), at), at)
        return self

    def happen(self, words: str, kind: str = "worker") -> None:
        """Publish an event of the job `mug`."""
        event = JobEvent(number=1000 + self.steps, at=datetime.now(UTC), kind=kind, words=words)  # type: ignore[arg-type]
        with self.lock:
            self.now = time.time()
            self.jobs.receive_answers({Keys("mug").event(kind): to_json(event)}, self.now)

    @contextmanager
    def going_on(self, interval: float = 0.2) -> Iterator[None]:
        """Go on by itself, from some way along."""
        now = time.time()
        for number in range(40, 0, -1):
            self.step(now - number)
        over = threading.Event()

        def go() -> None:
            while not over.wait(interval):
                self.step()

        thread = threading.Thread(target=go)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


def _values(job: str, runs: list[str], steps: int, gone: set[int], at: float) -> dict[str, bytes]:
    keys, told = Keys(job), min(steps * STEP, BUDGET)
    courses = [_run(name, told, steps, number) for number, name in enumerate(runs)]
    sums = {name: sum(getattr(one, name) for one in courses) for name in (*COUNTS, "budget")}
    done = len(runs) if told == BUDGET else 0
    counts = {"runs": len(runs), "runs_open": len(runs) - done, "runs_done": done, "workers": 4 - len(gone)}
    more = {"recorders": 1, "waiting": told % 37, "seconds": steps * 1.0}
    figures = sample_jobs.figures(job=job, rate=sums["evaluations"] / max(1, steps), **counts, **more, **sums)
    team = [_worker(number, number in gone, told) for number in range(4)]
    since = datetime.fromtimestamp(at - 40 - steps, UTC)
    values = {
        keys.meta: replace(sample_jobs.meta(job, len(runs)), since=since),
        keys.stat("job"): figures,
        **{keys.stat(f"run/{one.run}"): one for one in courses},
        **{keys.stat(f"team/{page.page}"): page for page in sample_jobs.team(*team)},
    }
    return {key: to_json(value) for key, value in values.items()}


def _run(name: str, told: int, steps: int, number: int) -> RunStatus:
    share = 0.28 + 0.04 * number
    held, shaken, dropped = int(told * share * 0.4), int(told * share * 0.15), int(told * share * 0.45)
    rest = told - held - shaken - dropped
    parts = {"dead_end": 0.1, "overlap": 0.47, "missed": 0.25, "brushed": 0.18}
    failed = {outcome: int(rest * part) for outcome, part in parts.items()}
    ends = {"dropped": dropped, "shaken": shaken, "held": held}
    spec = {"budget": BUDGET, "seed": number % 2, "object": name.split("-")[1] if "-" in name else name}
    counts = {"evaluations": told, "rows": told, "steps": 2 * told, "durable": told - told % 37}
    counts |= {"successes": held + shaken + dropped, "grasps": held + shaken, "robust": held}
    return sample_jobs.run(
        name,
        outcomes={"error": rest - sum(failed.values()), **failed, **ends},
        simulated=told - failed["overlap"] - failed["dead_end"],
        cells=int(90 * (1 + number / 6) * (told / 1000) ** 0.6),
        contact_niches=int(40 * (1 + number / 6) * (told / 1000) ** 0.5),
        seconds=steps * 1.0,
        rate=told / max(1, steps),
        finished="its budget is spent" if told == BUDGET else "",
        **spec,
        **counts,
    )


def _worker(number: int, is_gone: bool, told: int) -> WorkerStatus:
    gone, working = {"rate": 0.0, "batches": 0, "seen": 3.0}, {"batches": 2, "seen": 0.2 * number}
    doing = gone if is_gone else working | {"rate": 43.7 + number}
    own = {"host": f"node{number // 2 + 1}", "pid": 4100 + number, "memory": (180 + 7 * number) << 20}
    return sample_jobs.worker(number, state="gone" if is_gone else "working", rows=told // 4, **own, **doing)


def finds(
    numbers: ArrayLike,
    places: ArrayLike,
    outcomes: ArrayLike,
    joints: int = 2,
    synergies: ArrayLike = -1,
    etas: ArrayLike = -1,
    **columns: ArrayLike,
) -> SuccessTable:
    """Return finds with journal numbers (n,), cells (n, 3), outcomes (n,) and so on; not settled ones."""
    made = np.zeros(len(np.asarray(numbers)), success_dtype(joints, contact_slots=2))
    made["number"], made["outcome"], made["synergy"], made["eta"] = numbers, outcomes, synergies, etas
    made["descriptor"] = np.asarray(places) / 100
    made["base_to_object"][:, :3] = made["descriptor"]
    made["base_to_object"][:, 6] = 1
    made["fitness"] = made["outcome"].astype(int) - Outcome.DROPPED
    for name, values in columns.items():
        made[name] = values
    return made


def random_finds(n: int, reach: int = 3, seed: int = 0) -> SuccessTable:
    """Return `n` finds in few cells, at every other row of the journal."""
    random = np.random.default_rng(seed)
    places = random.integers(-reach, reach + 1, (n, 3))
    outcomes = random.integers(Outcome.DROPPED, Outcome.HELD + 1, n)
    labels, etas = random.integers(-1, 2, n), random.choice([-1, 0, 0.25, 0.5, 1], n)
    return finds(2 * np.arange(n), places, outcomes, synergies=labels, etas=etas)


ORIGIN = JournalId("1" * 64, 1.0)


@dataclass
class HandMadeRecords:
    """A single run, of whose finds each page has a few, and a clock; counts the queries."""

    a_scene: Scene
    found: SuccessTable = field(default_factory=lambda: finds([], np.zeros((0, 3)), []))
    rows: int = 0
    on_a_page: int = 4
    origin: JournalId = ORIGIN
    now: float = 100.0

    def record(self, found: SuccessTable) -> None:
        """Add these finds."""
        self.found = np.concatenate([self.found, found])
        self.rows = int(self.found["number"][-1]) + 1

    def become(self, scene: Scene, origin: JournalId, found: SuccessTable) -> None:
        """Be the records of another job of the same name."""
        self.a_scene, self.origin, self.found = scene, origin, found
        self.rows = int(found["number"][-1]) + 1

    def scene(self, job: str, run: str, digest: str) -> Scene:
        assert digest == self.origin.scene
        return self.a_scene

    def page(self, job: str, run: str, first: int) -> RecordPage:
        if run == "other":
            raise UnknownName("run", run, ["mug"])
        start = int(np.searchsorted(self.found["number"], first))
        shown = self.found[start : start + self.on_a_page]
        more = start + self.on_a_page < len(self.found)
        return RecordPage(
            self.origin, shown, int(shown["number"][-1]) + 1 if more else max(first, self.rows), self.rows
        )

    def entries(self, job: str) -> RunListings:
        if job == "hands":
            raise NoReply("nobody answers")
        return RunListings(runs=[])

    def objects(self, job: str) -> ObjectListings:
        return ObjectListings(objects=[])

    def curve(self, job: str, run: str) -> GrowthCurve:
        return GrowthCurve(run=run, points=[])


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser for the tests of a module; without one they are skipped."""
    with browser.launched() as launched:
        yield launched


@pytest.fixture
def look(chromium: Any) -> Iterator[Callable[..., Any]]:
    """Opens a page; any complaint of it fails the test."""
    visits: list[browser.Visit] = []

    def opened(address: str, **looks: Any) -> Any:
        visits.append(browser.Visit(chromium, address, **looks))
        return visits[-1].page

    yield opened
    for visit in visits:
        visit.context.close()
    assert [words for visit in visits for words in visit.complaints] == []


@pytest.fixture
def feed() -> FakeFeed:
    """Jobs that have done a little."""
    return FakeFeed().step().step().step()


def no_finds() -> JobCaches:
    """Records of the run `mug` and those of the job `hands`, without successes."""
    return JobCaches(HandMadeRecords(made_scene()))  # type: ignore[arg-type]  # it has what is asked


def client(feed: FakeFeed, access: Access | None = None, library: JobCaches | None = None) -> TestClient:
    """A client on this machine."""
    app = application(live_routes(feed, library or no_finds(), Stop()), access or Access(local=True))
    return TestClient(app, base_url="http://localhost:8080", follow_redirects=False)


def serving(
    feed: FakeFeed, port: int = 0, token: str = "", library: JobCaches | None = None
) -> AbstractContextManager[str]:
    """A server of a live page in a thread; gives its address, and ends it in the end."""
    return serving_routes(lambda stop: live_routes(feed, library or no_finds(), stop), port, token)


@contextmanager
def serving_routes(
    routes: Callable[[Stop], list[BaseRoute]], port: int = 0, token: str = ""
) -> Iterator[str]:
    """The same of any page; without a port at any that is free."""
    port = port or free_port()
    stop, open_at = Stop(), Queue[str]()
    thread = threading.Thread(target=serve, args=(routes(stop), HERE, port, token, stop, open_at.put))
    thread.start()
    try:
        assert open_at.get(timeout=PATIENCE).startswith(f"http://{HERE}:{port}/")
        yield f"http://{HERE}:{port}"
    finally:
        stop.set(15)
        thread.join(PATIENCE)
        assert not thread.is_alive(), "the server did not end"
