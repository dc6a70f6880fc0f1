"""Evaluations per second by hand, object and regime, and how their time is spent."""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import wraps
from multiprocessing.connection import Connection
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from benchmarks.hands import HANDS
from benchmarks.measure import ROUNDS, Figure, Ledger, Meter, spread
from benchmarks.naive import Naive, Published
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene, gripper_names, object_names
from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.local.benchmark_figures import BENCH_PRIOR, PoseRegime, RegimeSearch
from qdgrasp_coordinator.scheduler.batch_queue import BATCH_SECONDS, FIRST_ROWS
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.base import SearchAlgorithm, search_space
from qdgrasp_coordinator.search.registry import method, prior_of
from qdgrasp_protocol.rows import Genomes, Outcome, Rows
from qdgrasp_protocol.spec import DEFAULT_METHOD, RunSpec
from qdgrasp_worker.candidate_ranking import PoseFeatures
from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import Shake
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, Evaluator
from qdgrasp_worker.filters.contact_filter import ContactFilter
from qdgrasp_worker.filters.overlap_filter import OverlapFilter

REST = "rest"
"""Name of the time outside all stages: rows, lists and the loop."""
STEPS = ", steps"
"""Suffix of a stage's name for the simulator's own steps within it."""


def _shake(_: ShakenEpisode, shake: Shake, *rest: object) -> str:
    return f"shake {shake.joint}"


STAGES: list[tuple[type, str, str | Callable[..., str]]] = [
    (Decoder, "__call__", "decode"),
    (OverlapFilter, "__call__", "overlap filter"),
    (PoseFeatures, "features", "features"),
    (ContactFilter, "misses", "never-touch filter"),
    (ShakenEpisode, "overlaps", "place, overlap"),
    (ShakenEpisode, "_close", "closing"),
    (ShakenEpisode, "_holds_through", _shake),
]
"""The method of a class, and the stage that is spent in it, or what tells it from the arguments."""
ORDER = (
    "decode",
    "overlap filter",
    "features",
    "never-touch filter",
    "place, overlap",
    "closing",
    "shake z",
    "shake x",
    REST,
)
"""The stages in the order of an evaluation."""


class Profile:
    """Adds up what evaluations spend on each stage."""

    def __init__(self) -> None:
        self._ledger = Ledger()
        self._evaluations = 0
        self._steps = 0

    @contextmanager
    def watching(self, evaluations: int) -> Iterator[None]:
        """Watch so many evaluations that are made here."""
        self._evaluations += evaluations
        with ExitStack() as patches:
            for owner, name, stage in STAGES:
                patches.enter_context(patch.object(owner, name, self._within(getattr(owner, name), stage)))
            patches.enter_context(
                patch.object(BulletShakenWorld, "step", self._stepping(BulletShakenWorld.step))
            )
            with self._ledger.within(REST):
                yield

    def stages(self, microseconds: float) -> dict[str, float]:
        """An evaluation's time by stage, in an evaluation's order; it is so long without a watch."""
        seconds, whole = self._ledger.seconds, self._ledger.total
        names = [name for stage in ORDER for name in (stage, stage + STEPS) if name in seconds]
        return {name: microseconds * seconds[name] / whole for name in names}

    @property
    def steps_each(self) -> float:
        """The simulator's steps in an evaluation."""
        return self._steps / self._evaluations

    @property
    def step_share(self) -> float:
        """The share of all time that is spent in the simulator's steps: the lower bound."""
        steps = sum(time for name, time in self._ledger.seconds.items() if name.endswith(STEPS))
        return steps / self._ledger.total

    def _within(self, method: Callable[..., Any], stage: str | Callable[..., str]) -> Callable[..., Any]:
        @wraps(method)
        def watched(*arguments: Any, **named: Any) -> Any:
            with self._ledger.within(stage if isinstance(stage, str) else stage(*arguments, **named)):
                return method(*arguments, **named)

        return watched

    def _stepping(self, step: Callable[[BulletShakenWorld], None]) -> Callable[[BulletShakenWorld], None]:
        @wraps(step)
        def watched(world: BulletShakenWorld) -> None:
            self._steps += 1
            self._ledger.enter(self._ledger.inmost + STEPS)
            step(world)
            self._ledger.leave()

        return watched


WATCHED = 0.5
"""Time under a watch, as a share of the time without."""
DRAWS = 400
"""Bootstrap draws of the batches, for the interval.

Few poses take most of the time, so that all of them are taken together, not round by round.
"""


class TimedEvaluations:
    """Genomes of one search, evaluated in batches as large as a worker would get them."""

    def __init__(
        self,
        name: str,
        search: SearchAlgorithm,
        prior: str,
        evaluator: Evaluator,
        naive: Naive | None = None,
        first: int = 0,
    ) -> None:
        self.name = name
        self._search = search
        self._prior = prior
        self._evaluator = evaluator
        self._naive = naive
        self._generation = first
        self._waiting = np.zeros((0, 0), np.float32)
        self._told: list[Rows] = []
        self._outcomes: list[NDArray[np.uint8]] = []
        self._profile = Profile()
        self._rows: list[int] = []
        self._own: list[float] = []
        self._other: list[float] = []
        """Of each batch: its rows, and their seconds, of ours and of the naive path."""
        self._watched = 0.0

    def skip(self, rows: int) -> "TimedEvaluations":
        """Evaluate some genomes that are not counted."""
        for _ in range(0, rows, FIRST_ROWS):
            self._evaluate(self._next(FIRST_ROWS))
        return self

    def one(self, rows: int) -> int:
        """Evaluate one batch of so many rows, or fewer; returns the number."""
        genomes = self._next(rows)
        self._evaluate(genomes)
        return len(genomes)

    def measured(self, seconds: float) -> Figure:
        """Measure it for so long, the naive path's time included; and half of it once more, under a watch."""
        self._outcomes.clear()
        while sum(self._own) + sum(self._other) < seconds:
            self._measure(self._next(self._batch))
        rows, own, other = (np.array(column) for column in (self._rows, self._own, self._other))
        some = np.random.default_rng(0).integers(len(rows), size=(DRAWS, len(rows)))
        rates, times = (column[some].sum(axis=1) / own[some].sum(axis=1) for column in (rows, other))
        return Figure(
            self.name,
            sum(self._rows),
            sum(self._own),
            remark=self._remark,
            rates=tuple(rates.tolist()),
            published=tuple(times.tolist()) if self._naive else (),
            stages=self._profile.stages(1e6 * sum(self._own) / sum(self._rows)),
        )

    def _measure(self, genomes: Genomes) -> None:
        """Evaluate a batch; the naive path, and now and then we under a watch, do the same."""
        own, other, watched = Meter(), Meter(), Meter()
        with own.running():
            self._evaluate(genomes)
        if self._naive:
            with other.running():
                self._naive.evaluate(self._prior, genomes)
        if self._watched < WATCHED * (sum(self._own) + own.seconds):
            with watched.running(), self._profile.watching(len(genomes)):
                self._evaluated(genomes)
        self._watched += watched.seconds
        for column, value in (
            (self._rows, len(genomes)),
            (self._own, own.seconds),
            (self._other, other.seconds),
        ):
            column.append(value)

    @property
    def _batch(self) -> int:
        """Rows that the coordinator would lease, as far as the worker evaluates them at once."""
        if not self._rows:
            return FIRST_ROWS
        return max(1, min(ROWS_AT_ONCE, int(BATCH_SECONDS * sum(self._rows) / sum(self._own))))

    def _next(self, rows: int) -> Genomes:
        """The next genomes, at most so many; the search hears of a generation that is complete."""
        if not len(self._waiting):
            self._tell()
            self._waiting = self._search.ask(self._generation)
        genomes, self._waiting = self._waiting[:rows], self._waiting[rows:]
        return genomes

    def _evaluate(self, genomes: Genomes) -> None:
        self._told.append(self._evaluated(genomes))
        self._outcomes.append(self._told[-1]["outcome"])

    def _evaluated(self, genomes: Genomes) -> Rows:
        return self._evaluator.evaluate(self._prior, genomes, np.zeros(len(genomes), np.uint16)).rows

    def _tell(self) -> None:
        """Tell the search of the generation that is complete, if one is."""
        if not self._told:
            return
        rows = np.concatenate(self._told)
        rows["generation"], rows["index"] = self._generation, np.arange(len(rows))
        self._search.tell(self._generation, rows)
        self._generation += 1
        self._told.clear()

    @property
    def _remark(self) -> str:
        outcomes = np.concatenate(self._outcomes)
        overlaps, successes = (outcomes == Outcome.OVERLAP).mean(), (outcomes >= Outcome.DROPPED).mean()
        return (
            f"{overlaps:.0%} overlaps, {successes:.0%} successes; {self._profile.steps_each:.0f} steps, "
            f"{self._profile.step_share:.0%} of the time"
        )


WARM = 200
"""Genomes of the search before it is measured: by then it has found its first grasps."""


TURNS = {PoseRegime.ANYWHERE: 2.0, PoseRegime.NEAR: 1.0}
"""Factor by which poses anywhere are measured longer: few of them take most of the time."""


class Pair(NamedTuple):
    """A hand and an object, and the further measurements of them."""

    hand: str
    object: str
    protocol: str = "paper"
    searched: bool = True
    """Whether the default method is measured, too."""

    @property
    def published(self) -> str:
        """The hand of the public code: the published model, where it is there."""
        hand = HANDS.get(self.hand, self.hand)
        return hand if hand in gripper_names() else self.hand


BUILT_IN = [
    Pair("panda", "rubiks_cube"),
    Pair("panda", "mug"),
    Pair("barrett", "rubiks_cube"),
    Pair("allegro", "rubiks_cube"),
    Pair("allegro", "mug"),
    Pair("shadow", "rubiks_cube"),
    Pair("robotiq_2f", "mug"),
]
REFERENCE = [
    Pair("ref_panda_2f", "ycb_rubiks_cube", "released", searched=False),
    Pair("ref_panda_2f", "ycb_mug", "released", searched=False),
    Pair("ref_bh280", "ycb_rubiks_cube", "released", searched=False),
    Pair("ref_allegro", "ycb_rubiks_cube", "released", searched=False),
    Pair("ref_shadow", "ycb_mug", "released", searched=False),
]


def measure_evaluations(seconds: float) -> Iterator[Figure]:
    hands, things = gripper_names(), object_names()
    for pair in BUILT_IN + REFERENCE:
        if pair.hand in hands and pair.object in things:
            yield from _pair(pair, seconds)


def _pair(pair: Pair, seconds: float) -> Iterator[Figure]:
    scene, theirs = (
        build_scene(RunSpec(gripper=hand, object=pair.object, protocol=pair.protocol))
        for hand in (pair.hand, pair.published)
    )
    regimes, name = RegimeSearch(layout(scene, BENCH_PRIOR)), f"{pair.hand} on {pair.object}"
    with Evaluator(scene) as evaluator, closing(Published(theirs)) as naive:
        looking = TimedEvaluations(name, regimes, BENCH_PRIOR, evaluator)
        while not regimes.has_parents:
            looking.skip(ROWS_AT_ONCE)
        for regime in (PoseRegime.ANYWHERE, PoseRegime.NEAR):
            regimes.start_regime(regime, ROWS_AT_ONCE)
            lot = TimedEvaluations(
                f"{name}, {regime.value}", regimes, BENCH_PRIOR, evaluator, naive, regimes.since
            )
            yield lot.measured(seconds * TURNS[regime])
        if pair.searched:
            yield _searched(pair, evaluator).skip(WARM).measured(seconds / 2)


def _searched(pair: Pair, evaluator: Evaluator) -> TimedEvaluations:
    spec = full_spec({"gripper": pair.hand, "object": pair.object, "method": DEFAULT_METHOD})
    chosen, name = method(spec.method), f"{pair.hand} on {pair.object}, {spec.method}"
    prior = prior_of(spec)
    return TimedEvaluations(name, chosen.build(spec, search_space(evaluator.scene, prior)), prior, evaluator)


HAND, OBJECT = "panda", "mug"
PROCESSES = 2
BATCHES = {PoseRegime.ANYWHERE: ROWS_AT_ONCE, PoseRegime.NEAR: FIRST_ROWS}
"""Rows that are evaluated at once: small against a turn."""


def measure_scaling(seconds: float) -> list[Figure]:
    with ExitStack() as stack:
        workers = [stack.enter_context(_process(number)) for number in range(PROCESSES)]
        for worker in workers:
            worker.recv()
        return [
            line
            for regime in (PoseRegime.ANYWHERE, PoseRegime.NEAR)
            for line in _lines(workers, regime, seconds)
        ]


class Turn(NamedTuple):
    """Speed of processes that evaluate side by side."""

    rate: float
    """Evaluations per second of wall-clock time."""
    cost: float
    """CPU seconds per evaluation."""


def _lines(workers: list[Connection], regime: PoseRegime, seconds: float) -> Iterator[Figure]:
    turns: dict[int, list[Turn]] = {1: [], PROCESSES: []}
    for _ in range(ROUNDS):
        for count, found in turns.items():
            found.append(_turn(workers[:count], regime, seconds / ROUNDS))
    for count, found in turns.items():
        name = f"{HAND} on {OBJECT}, {regime.value}, {count} process{'' if count == 1 else 'es'}"
        rates = tuple(turn.rate for turn in found)
        remark = "wall time" + (_gain(turns[1], found) if count > 1 else "")
        yield Figure(name, sum(rates) * seconds / ROUNDS, seconds, "wall", remark, rates)


def _turn(workers: list[Connection], regime: PoseRegime, seconds: float) -> Turn:
    for worker in workers:
        worker.send((regime, seconds))
    rows, rates, cpu = zip(*(worker.recv() for worker in workers), strict=True)
    return Turn(sum(rates), sum(cpu) / sum(rows))


def _gain(alone: list[Turn], together: list[Turn]) -> str:
    rates, costs = zip(
        *((b.rate / a.rate, b.cost / a.cost) for a, b in zip(alone, together, strict=True)), strict=True
    )
    return f"; {spread(rates)} times one process, {spread(costs)} times its CPU time each"


@contextmanager
def _process(number: int) -> Iterator[Connection]:
    """A process that evaluates when it is told to; it ends with the block."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, number), daemon=True)
    process.start()
    try:
        there.close()  # so that the end of the process is seen
        yield here
    finally:
        here.send(None)
        process.join()


def _serve(pipe: Connection, number: int) -> None:
    scene = build_scene(RunSpec(gripper=HAND, object=OBJECT))
    regimes = RegimeSearch(layout(scene, BENCH_PRIOR))
    with Evaluator(scene) as evaluator:
        lot = TimedEvaluations(str(number), regimes, BENCH_PRIOR, evaluator)
        while not regimes.has_parents:
            lot.skip(ROWS_AT_ONCE)
        pipe.send(None)
        while (asked := pipe.recv()) is not None:
            regime, seconds = asked
            regimes.start_regime(regime, ROWS_AT_ONCE)
            began, cpu, rows = time.perf_counter(), time.process_time(), 0
            while time.perf_counter() < began + seconds:
                rows += lot.one(BATCHES[regime])
            pipe.send((rows, rows / (time.perf_counter() - began), time.process_time() - cpu))
