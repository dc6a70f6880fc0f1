"""The time left over simulated campaigns, and a job's work while no rows come in."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from tests.tools.monitor.sample_jobs import figures

from qdgrasp_coordinator.metrics.time_left import (
    QUIET_SECONDS,
    TimeLeft,
    WorkCounts,
    WorkersAtWork,
    activity,
    follow,
    with_time_left,
)
from qdgrasp_protocol.messages import Heartbeat

STEP = 0.5  # seconds between two looks, as statuses are published


@dataclass
class SimulatedCampaign:
    """A campaign of objects whose shapes are built first, carried out by workers in simulated time.

    A worker takes the next shape if rows of fewer objects than workers wait, as a coordinator leases, else
    rows; the first rows of an object wait for its scene.
    """

    objects: int
    shape_seconds: float
    row_seconds: float
    rows: int
    workers: int
    scene_seconds: float = 5.0
    now: float = 0.0
    built: int = 0
    done: int = 0
    jobs: dict[int, tuple[str, float]] = field(default_factory=dict)
    opened: int = 0

    def look(self) -> WorkCounts:
        """Return the counts now."""
        kinds = [kind for kind, _ in self.jobs.values()]
        return WorkCounts(
            rows=self.done,
            evaluations=self.done,
            remaining=self.objects * self.rows - self.done,
            shapes_left=self.objects - self.built,
            shape_seconds=self.shape_seconds if self.built else 0.0,
            workers=self.workers,
            evaluators=kinds.count("rows"),
            builders=kinds.count("shape"),
        )

    def run(self) -> Iterator[tuple[float, WorkCounts]]:
        """Yield time and counts until all is done."""
        while self.done < self.objects * self.rows:
            for worker in range(self.workers):
                if worker in self.jobs and self.now >= self.jobs[worker][1]:
                    self._end(self.jobs.pop(worker)[0])
                if worker not in self.jobs:
                    self._begin(worker)
            yield self.now, self.look()
            self.now += STEP

    def _end(self, kind: str) -> None:
        if kind == "shape":
            self.built += 1
        else:
            self.done += 10

    def _begin(self, worker: int) -> None:
        building = [kind for kind, _ in self.jobs.values()].count("shape")
        under_way = [kind for kind, _ in self.jobs.values()].count("rows")
        ready = self.built * self.rows - self.done - 10 * under_way
        if ready < 10 * self.workers and self.built + building < self.objects:
            self.jobs[worker] = "shape", self.now + self.shape_seconds
        elif ready > 0:
            first = self.scene_seconds if self.opened < self.built else 0.0
            self.opened = self.built
            self.jobs[worker] = "rows", self.now + first + 10 * self.row_seconds


CAMPAIGNS = [
    SimulatedCampaign(objects=12, shape_seconds=60.0, row_seconds=0.05, rows=1000, workers=2),
    SimulatedCampaign(objects=30, shape_seconds=20.0, row_seconds=0.1, rows=500, workers=8),
    SimulatedCampaign(objects=1, shape_seconds=90.0, row_seconds=0.1, rows=5000, workers=4),
]


def shown(campaign: SimulatedCampaign) -> list[tuple[float, float | None]]:
    """Return the time shown at each look of a simulated campaign."""
    left = TimeLeft()
    return [(now, left.note(counts, now)) for now, counts in campaign.run()]


@pytest.mark.parametrize("number", range(len(CAMPAIGNS)))
def test_the_time_left_hardly_grows_and_is_about_right(number: int) -> None:
    whole = CAMPAIGNS[number]
    told = [(now, seconds) for now, seconds in shown(whole) if seconds is not None]
    end, known_since = whole.now, told[0][0]
    later = [(now, seconds) for now, seconds in told if now > known_since + 60.0]
    least = later[0][1]
    for now, seconds in later:
        assert seconds <= least * 1.15 + 15.0
        least = min(least, seconds)
        assert seconds == pytest.approx(end - now, rel=0.35, abs=45.0)


def test_a_time_that_is_known_does_not_grow_while_workers_build_and_no_row_comes() -> None:
    left = TimeLeft()
    counts = WorkCounts(0, 0, 10_000, 3, 30.0, 2, 2, 0)
    for second in range(100):
        counts = counts._replace(rows=10 * second, evaluations=10 * second, remaining=10_000 - 10 * second)
        left.note(counts, float(second))
    building = counts._replace(evaluators=0, builders=2)
    seen = [left.note(building, float(second)) for second in range(100, 400)]
    assert seen == sorted(seen, reverse=True)
    assert seen[0] == pytest.approx(901.0 + 45.0, rel=0.03)


def test_the_wait_for_the_first_scene_counts_for_no_row() -> None:
    left = TimeLeft()
    counts = WorkCounts(0, 0, 1000, 0, 0.0, 1, 1, 0)
    assert all(left.note(counts, second) is None for second in range(60))
    assert left.note(counts._replace(rows=10, evaluations=10, remaining=990), 60.0) is None
    assert left.note(counts._replace(rows=30, evaluations=30, remaining=970), 62.0) == pytest.approx(97.0)


def test_a_run_that_is_replayed_meanwhile_is_no_speed() -> None:
    left = TimeLeft()
    for second, replayed in enumerate((0, 5000, 50_000)):
        job = figures(**(BEGUN | {"evaluations": replayed, "remaining": 100, "seconds": float(second)}))
        shown = with_time_left(job, at_work({"rows": 50}), 0.0, left, float(second))
    assert (shown.seconds_left, shown.doing) == (None, "first poses: candidates are screened")


def test_a_job_with_nothing_left_has_no_time_left_at_once() -> None:
    left = TimeLeft()
    counts = WorkCounts(0, 0, 100, 0, 0.0, 1, 1, 0)
    for second in range(1, 4):
        told = left.note(counts._replace(rows=second, evaluations=second, remaining=100 - second), second)
    assert told is not None
    assert told > 0.0
    assert left.note(counts._replace(rows=100, evaluations=100, remaining=0), 4.0) == 0.0


def test_more_workers_take_less_time() -> None:
    left, done = TimeLeft(), 0
    counts = WorkCounts(0, 0, 100_000, 0, 0.0, 2, 2, 0)
    times = []
    for second in range(400):
        workers = 2 if second < 200 else 8
        done += 5 * workers
        counts = counts._replace(rows=done, evaluations=done, remaining=100_000 - done)
        times.append(left.note(counts._replace(workers=workers, evaluators=workers), float(second)))
    assert times[199] == pytest.approx(9800.0, rel=0.02)
    assert times[399] == pytest.approx(2250.0, rel=0.02)


@pytest.mark.parametrize(("estimate", "between"), [(50.0, (50.0, 99.0)), (300.0, (99.0, 300.0))])
def test_what_is_shown_follows_an_estimate_without_a_jump(estimate: float, between) -> None:
    low, high = between
    assert low < follow(100.0, estimate, 1.0) < high
    assert follow(100.0, estimate, 1000.0) == pytest.approx(estimate)


def at_work(*signs: dict[str, object], builders: int = 0, settled: int = 0) -> WorkersAtWork:
    """Workers at work, by what their signs say."""
    common = {"wid": 32 * "0", "host": "here"}
    return WorkersAtWork(builders, [Heartbeat(**(common | sign)) for sign in signs], settled)


BEGUN = {"state": "running", "runs_open": 1, "workers": 2, "evaluations": 0, "rate": 0.0}
WORDS = [
    ({"state": "starting"}, at_work(), "waiting for the recorder"),
    ({"workers": 0}, at_work(), "waiting for workers"),
    (
        {"building": ["a/cup.stl", "b.stl"], "runs_open": 0},
        at_work(builders=1),
        "building the shape of cup.stl",
    ),
    (
        {"building": [f"{n}.stl" for n in range(9)], "runs_open": 0},
        at_work(builders=4),
        "building the shapes of 0.stl, 1.stl and 2 more",
    ),
    ({"runs_open": 0}, at_work(), "making the scene of the next run"),
    ({"runs_open": 0, "building": ["cup.stl"]}, at_work(), "waiting for a worker that builds shapes"),
    ({}, at_work(), "handing out poses"),
    ({}, at_work(*[{"loading": True, "rows": 50}] * 2), "2 workers loading the scene"),
    ({}, at_work(*[{"rows": 50}] * 2), "first poses: candidates are screened"),
    ({}, at_work(*[{"rows": 50, "done": 3}] * 2), "first poses: 6 of 100 poses evaluated"),
]


@pytest.mark.parametrize(("more", "work", "words"), WORDS)
def test_it_is_said_what_a_job_does_before_its_first_row(more, work: WorkersAtWork, words: str) -> None:
    assert activity(figures(**(BEGUN | more)), work, has_begun=False) == words


def test_it_is_said_at_once_at_the_beginning_and_after_a_while_without_rows_later() -> None:
    left = TimeLeft()

    def doing(evaluations: int, now: float) -> str:
        job = figures(**(BEGUN | {"evaluations": evaluations, "seconds": now, "rate": evaluations / now}))
        return with_time_left(
            job, at_work({"rows": 50, "done": 20}, settled=evaluations), 0.0, left, now
        ).doing

    assert doing(0, 1.0) == "first poses: 20 of 50 poses evaluated"
    assert doing(50, 2.0) == doing(50, 2.0 + QUIET_SECONDS) == ""
    assert doing(50, 3.0 + QUIET_SECONDS) == "20 of 50 poses evaluated"
    assert doing(60, 4.0 + QUIET_SECONDS) == ""


def test_a_job_that_is_paused_does_nothing() -> None:
    job = figures(**(BEGUN | {"state": "paused"}))
    assert with_time_left(job, at_work(), 0.0, TimeLeft(), 1.0).doing == ""
