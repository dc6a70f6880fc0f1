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
from benchmarks.benchmark_figures import BENCH_PRIOR, PoseRegime, RegimeSearch
from benchmarks.hands import HANDS
from benchmarks.measure import ROUNDS, Figure, Meter, StageTimer, spread
from benchmarks.naive import NaiveEvaluator, PublishedEvaluator
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene, gripper_names, object_names
from qdgrasp_assets.genes import layout
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


class StageProfile:
    """Adds up the time that evaluations spend in each stage."""

    def __init__(self) -> None:
        self._timer = StageTimer()
        self._evaluations = 0
        self._steps = 0

    @contextmanager
    def profiling(self, evaluations: int) -> Iterator[None]:
        """Profile so many evaluations that are made in this block."""
        self._evaluations += evaluations
        with ExitStack() as patches:
            for owner, name, stage in STAGES:
                patches.enter_context(patch.object(owner, name, self._within(getattr(owner, name), stage)))
            patches.enter_context(
                patch.object(BulletShakenWorld, "step", self._stepping(BulletShakenWorld.step))
            )
            with self._timer.within(REST):
                yield

    def stages(self, microseconds: float) -> dict[str, float]:
        """An evaluation's time by stage, in order; `microseconds` is its time without profiling."""
        seconds, whole = self._timer.seconds, self._timer.total
        names = [name for stage in ORDER for name in (stage, stage + STEPS) if name in seconds]
        return {name: microseconds * seconds[name] / whole for name in names}

    @property
    def steps_each(self) -> float:
        """The simulator's steps in an evaluation."""
        return self._steps / self._evaluations

    @property
    def step_share(self) -> float:
        """The share of all time that is spent in the simulator's steps: the lower bound."""
        steps = sum(time for name, time in self._timer.seconds.items() if name.endswith(STEPS))
        return steps / self._timer.total

    def _within(self, method: Callable[..., Any], stage: str | Callable[..., str]) -> Callable[..., Any]:
        @wraps(method)
        def timed(*arguments: Any, **named: Any) -> Any:
            with self._timer.within(stage if isinstance(stage, str) else stage(*arguments, **named)):
                return method(*arguments, **named)

        return timed

    def _stepping(self, step: Callable[[BulletShakenWorld], None]) -> Callable[[BulletShakenWorld], None]:
        @wraps(step)
        def timed(world: BulletShakenWorld) -> None:
            self._steps += 1
            self._timer.enter(self._timer.current + STEPS)
            step(world)
            self._timer.leave()

        return timed


PROFILED_SHARE = 0.5
"""Time with profiling, as a share of the time without."""
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
        naive: NaiveEvaluator | None = None,
        first: int = 0,
    ) -> None:
        self.name = name
        self._search = search
        self._prior = prior
        self._evaluator = evaluator
        self._naive = naive
        self._generation = first
        self._waiting = np.zeros((0, 0), np.float32)
        self._untold: list[Rows] = []
        self._outcomes: list[NDArray[np.uint8]] = []
        self._profile = StageProfile()
        self._rows: list[int] = []
        self._own: list[float] = []
        self._other: list[float] = []
        """Of each batch: its rows, and their seconds, of ours and of the naive path."""
        self._profiled_seconds = 0.0

    def skip(self, rows: int) -> "TimedEvaluations":
        """Evaluate some genomes that are not counted."""
        for _ in range(0, rows, FIRST_ROWS):
            self._evaluate(self._next(FIRST_ROWS))
        return self

    def evaluate_batch(self, rows: int) -> int:
        """Evaluate one batch of so many rows, or fewer; returns the number."""
        genomes = self._next(rows)
        self._evaluate(genomes)
        return len(genomes)

    def measured(self, seconds: float) -> Figure:
        """Measure it for so long, the naive path's time included; and half of it once more, profiled."""
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
        """Evaluate a batch, with the naive path too, and now and then once more with profiling."""
        own, other, profiled = Meter(), Meter(), Meter()
        with own.running():
            self._evaluate(genomes)
        if self._naive:
            with other.running():
                self._naive.evaluate(self._prior, genomes)
        if self._profiled_seconds < PROFILED_SHARE * (sum(self._own) + own.seconds):
            with profiled.running(), self._profile.profiling(len(genomes)):
                self._evaluated(genomes)
        self._profiled_seconds += profiled.seconds
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
        self._untold.append(self._evaluated(genomes))
        self._outcomes.append(self._untold[-1]["outcome"])

    def _evaluated(self, genomes: Genomes) -> Rows:
        return self._evaluator.evaluate(self._prior, genomes, np.zeros(len(genomes), np.uint16)).rows

    def _tell(self) -> None:
        """Tell the search of the generation that is complete, if one is."""
        if not self._untold:
            return
        rows = np.concatenate(self._untold)
        rows["generation"], rows["index"] = self._generation, np.arange(len(rows))
        self._search.tell(self._generation, rows)
        self._generation += 1
        self._untold.clear()

    @property
    def _remark(self) -> str:
        outcomes = np.concatenate(self._outcomes)
        overlaps, successes = (outcomes == Outcome.OVERLAP).mean(), (outcomes >= Outcome.DROPPED).mean()
        return (
            f"{overlaps:.0%} overlaps, {successes:.0%} successes; {self._profile.steps_each:.0f} steps, "
            f"{self._profile.step_share:.0%} of the time"
        )


WARM_UP = 200
"""Genomes of the search before it is measured: by then it has found its first grasps."""


TIME_FACTORS = {PoseRegime.ANYWHERE: 2.0, PoseRegime.NEAR: 1.0}
"""Factor by which poses anywhere are measured longer: few of them take most of the time."""


class HandAndObject(NamedTuple):
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
    HandAndObject("panda", "rubiks_cube"),
    HandAndObject("panda", "mug"),
    HandAndObject("barrett", "rubiks_cube"),
    HandAndObject("allegro", "rubiks_cube"),
    HandAndObject("allegro", "mug"),
    HandAndObject("shadow", "rubiks_cube"),
    HandAndObject("robotiq_2f", "mug"),
]
REFERENCE = [
    HandAndObject("ref_panda_2f", "ycb_rubiks_cube", "released", searched=False),
    HandAndObject("ref_panda_2f", "ycb_mug", "released", searched=False),
    HandAndObject("ref_bh280", "ycb_rubiks_cube", "released", searched=False),
    HandAndObject("ref_allegro", "ycb_rubiks_cube", "released", searched=False),
    HandAndObject("ref_shadow", "ycb_mug", "released", searched=False),
]


def measure_evaluations(seconds: float) -> Iterator[Figure]:
    hands, things = gripper_names(), object_names()
    for pair in BUILT_IN + REFERENCE:
        if pair.hand in hands and pair.object in things:
            yield from _measure_pair(pair, seconds)


def _measure_pair(pair: HandAndObject, seconds: float) -> Iterator[Figure]:
    scene, theirs = (
        build_scene(RunSpec(gripper=hand, object=pair.object, protocol=pair.protocol))
        for hand in (pair.hand, pair.published)
    )
    regimes, name = RegimeSearch(layout(scene, BENCH_PRIOR)), f"{pair.hand} on {pair.object}"
    with Evaluator(scene) as evaluator, closing(PublishedEvaluator(theirs)) as naive:
        warm_up = TimedEvaluations(name, regimes, BENCH_PRIOR, evaluator)
        while not regimes.has_parents:
            warm_up.skip(ROWS_AT_ONCE)
        for regime in (PoseRegime.ANYWHERE, PoseRegime.NEAR):
            regimes.start_regime(regime, ROWS_AT_ONCE)
            timed = TimedEvaluations(
                f"{name}, {regime.value}", regimes, BENCH_PRIOR, evaluator, naive, regimes.since
            )
            yield timed.measured(seconds * TIME_FACTORS[regime])
        if pair.searched:
            yield _searched(pair, evaluator).skip(WARM_UP).measured(seconds / 2)


def _searched(pair: HandAndObject, evaluator: Evaluator) -> TimedEvaluations:
    spec = full_spec({"gripper": pair.hand, "object": pair.object, "method": DEFAULT_METHOD})
    chosen, name = method(spec.method), f"{pair.hand} on {pair.object}, {spec.method}"
    prior = prior_of(spec)
    return TimedEvaluations(name, chosen.build(spec, search_space(evaluator.scene, prior)), prior, evaluator)


HAND, OBJECT = "panda", "mug"
PROCESSES = 2
BATCHES = {PoseRegime.ANYWHERE: ROWS_AT_ONCE, PoseRegime.NEAR: FIRST_ROWS}
"""Rows that are evaluated at once: small against a round."""


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


class RoundSpeed(NamedTuple):
    """Speed of processes that evaluate side by side."""

    rate: float
    """Evaluations per second of wall-clock time."""
    cost: float
    """CPU seconds per evaluation."""


def _lines(workers: list[Connection], regime: PoseRegime, seconds: float) -> Iterator[Figure]:
    rounds: dict[int, list[RoundSpeed]] = {1: [], PROCESSES: []}
    for _ in range(ROUNDS):
        for count, found in rounds.items():
            found.append(_measure_round(workers[:count], regime, seconds / ROUNDS))
    for count, found in rounds.items():
        name = f"{HAND} on {OBJECT}, {regime.value}, {count} process{'' if count == 1 else 'es'}"
        rates = tuple(one.rate for one in found)
        remark = "wall time" + (_gain(rounds[1], found) if count > 1 else "")
        yield Figure(name, sum(rates) * seconds / ROUNDS, seconds, "wall", remark, rates)


def _measure_round(workers: list[Connection], regime: PoseRegime, seconds: float) -> RoundSpeed:
    for worker in workers:
        worker.send((regime, seconds))
    rows, rates, cpu = zip(*(worker.recv() for worker in workers), strict=True)
    return RoundSpeed(sum(rates), sum(cpu) / sum(rows))


def _gain(alone: list[RoundSpeed], together: list[RoundSpeed]) -> str:
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
        timed = TimedEvaluations(str(number), regimes, BENCH_PRIOR, evaluator)
        while not regimes.has_parents:
            timed.skip(ROWS_AT_ONCE)
        pipe.send(None)
        while (asked := pipe.recv()) is not None:
            regime, seconds = asked
            regimes.start_regime(regime, ROWS_AT_ONCE)
            began, cpu, rows = time.perf_counter(), time.process_time(), 0
            while time.perf_counter() < began + seconds:
                rows += timed.evaluate_batch(BATCHES[regime])
            pipe.send((rows, rows / (time.perf_counter() - began), time.process_time() - cpu))
