"""Jobs as a feed knows them, made by hand: they go on by a step whenever they are told to."""

import threading
import time
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

import msgspec
import numpy as np
from msgspec.structs import replace
from tests.coordinator.monitor import shown

from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import Figures, to_json
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.monitor.jobs import Jobs, JobView
from qdgrasp_coordinator.monitor.web.geometry import Kind, Link, Stage, Triangles
from qdgrasp_coordinator.monitor.web.voxels import HEADER, MARK
from qdgrasp_protocol.errors import NoReply, UnknownName
from qdgrasp_protocol.keys import Keys

BUDGET = 90_000
STEP = 60


class FakeFeed:
    """A single run `mug`, and a job `hands` of six."""

    def __init__(self) -> None:
        self.jobs = Jobs()
        self.steps = 0
        self.gone: set[int] = set()
        self.lock = threading.Lock()

    @property
    def is_linked(self) -> bool:
        return self.jobs.is_linked

    @property
    def strangers(self) -> list[str]:
        return self.jobs.strangers

    def views(self) -> list[JobView]:
        with self.lock:
            return self.jobs.views(time.time())

    def step(self, at: float | None = None) -> None:
        """Go on by some evaluations."""
        self.steps += 1
        at = time.time() if at is None else at
        with self.lock:
            self.jobs.answered(_values("mug", ["mug"], self.steps, self.gone, at), at)
            names = [f"panda-{what}-aimed-s{seed}" for what in ("mug", "drill", "banana") for seed in (0, 1)]
            self.jobs.answered(_values("hands", names, self.steps, set(), at), at)

    def happen(self, words: str, kind: str = "worker") -> None:
        """Have something happen in the job `mug`."""
        event = Event(number=1000 + self.steps, at=datetime.now(UTC), kind=kind, words=words)  # type: ignore[arg-type]
        with self.lock:
            self.jobs.answered({Keys("mug").event(kind): to_json(event)}, time.time())

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
    sums = {
        name: sum(getattr(one, name) for one in courses)
        for name in (
            "evaluations",
            "successes",
            "cells",
            "grasps",
            "robust",
            "simulated",
            "overlaps",
            "budget",
        )
    }
    done = len(runs) if told == BUDGET else 0
    figures = shown.figures(
        job=job,
        runs=len(runs),
        runs_open=len(runs) - done,
        runs_done=done,
        workers=4 - len(gone),
        recorders=1,
        waiting=told % 37,
        seconds=steps * 1.0,
        rate=sums["evaluations"] / max(1, steps),
        **sums,
    )
    team = [_worker(number, number in gone, told) for number in range(4)]
    values = {
        keys.meta: replace(shown.meta(job, len(runs)), since=datetime.fromtimestamp(at - 40 - steps, UTC)),
        keys.stat("job"): figures,
        **{keys.stat(f"run/{one.run}"): one for one in courses},
        **{keys.stat(f"team/{page.page}"): page for page in shown.team(*team)},
    }
    return {key: to_json(value) for key, value in values.items()}


def _run(name: str, told: int, steps: int, number: int) -> Figures:
    share = 0.28 + 0.04 * number
    held, shaken, dropped = int(told * share * 0.4), int(told * share * 0.15), int(told * share * 0.45)
    rest = told - held - shaken - dropped
    parts = {"dead_end": 0.1, "overlap": 0.47, "missed": 0.25, "brushed": 0.18}
    failed = {outcome: int(rest * part) for outcome, part in parts.items()}
    outcomes = {
        "error": rest - sum(failed.values()),
        **failed,
        "dropped": dropped,
        "shaken": shaken,
        "held": held,
    }
    return shown.run(
        name,
        evaluations=told,
        budget=BUDGET,
        rows=told,
        seed=number % 2,
        object=name.split("-")[1] if "-" in name else name,
        outcomes=outcomes,
        simulated=told - failed["overlap"] - failed["dead_end"],
        proposals=2 * told,
        successes=held + shaken + dropped,
        grasps=held + shaken,
        robust=held,
        cells=int(90 * (1 + number / 6) * (told / 1000) ** 0.6),
        durable=told - told % 37,
        seconds=steps * 1.0,
        rate=told / max(1, steps),
        finished="its budget is spent" if told == BUDGET else "",
    )


def _worker(number: int, is_gone: bool, told: int) -> WorkerFigures:
    return shown.worker(
        number,
        host=f"node{number // 2 + 1}",
        pid=4100 + number,
        state="gone" if is_gone else "working",
        rate=0.0 if is_gone else 43.7 + number,
        rows=told // 4,
        batches=0 if is_gone else 2,
        seen=3.0 if is_gone else 0.2 * number,
        memory=(180 + 7 * number) << 20,
    )


class FakeLibrary:
    """A library of runs in which nothing was found; nobody lists those of the job `hands`."""

    def runs(self, job: str) -> bytes:
        if job == "hands":
            raise NoReply("nobody answers")
        return b'{"runs":[],"next":0,"uncounted":0}'

    def curve(self, job: str, run: str) -> bytes:
        return b'{"run":"","points":[]}'

    def scene(self, job: str, run: str) -> bytes:
        if run != "mug" and not run.startswith("panda"):
            raise UnknownName("run", run, ["mug"])
        return msgspec.json.encode(STAGE)

    def cells(self, job: str, run: str, since: int) -> bytes:
        return HEADER.pack(MARK, 0, since, 0, 0, 7)

    def grasp(self, job: str, run: str, number: int) -> bytes:
        return b'{"number":%d}' % number


CORNERS = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]], "<f4")
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "<u4")
MESH = Triangles(b64encode(CORNERS.tobytes()).decode(), b64encode(SIDES.tobytes()).decode())
STAGE = Stage(
    gripper="panda",
    object="mug",
    base="palm",
    com_in_mesh=(0, 0, 0.02),
    synergies=("pinch", "power"),
    scored=True,
    cell=0.01,
    low=(0, 0, 0),
    high=(0.05, 0.05, 0.05),
    reach=0.2,
    kinds=[Kind(5, "no shake survived", "#bdb7ad"), Kind(6, "one", "#f2a431"), Kind(7, "both", "#2a73b9")],
    mesh=MESH,
    links=[Link("palm", False, MESH)],
    origin=7,
)
