"""The tools that the benchmarks measure with; their figures are not tested."""

import json
import math
import shlex

import numpy as np
import pytest
from benchmarks import figure, limits, warm_start
from benchmarks.evaluation_speed import BUILT_IN, ORDER, REFERENCE, REST, STAGES, STEPS, StageProfile
from benchmarks.measure import Figure, Meter, StageTimer, TimedWork, measure_in_turns, number, spread
from benchmarks.node_benchmark import PlatformSink
from benchmarks.scale.rig import (
    JOB,
    SHAPE,
    VARIETY,
    CoordinatorMeasurement,
    GivenRuns,
    PreparedResults,
    ScaleFigure,
    StandInGroup,
    coordinate,
    make_run_plan,
    resident,
    router,
    rows,
    start_stand_ins,
)
from benchmarks.scale.slow_clients import TimedBus, compared, measure_window_pairs, monitors
from benchmarks.scale.throughput import BATCH, ConstantSearch, ProfiledSearch, spec
from benchmarks.side_by_side import side_by_side
from tests.common import own_endpoint
from tests.coordinator.recorded_runs import random_rows
from tests.coordinator.search.synthetic_scene import plain

from qdgrasp_assets.catalog import gripper_names, object_names
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceSet
from qdgrasp_coordinator.metrics.run_stats import evaluation_mask, successes
from qdgrasp_coordinator.scheduler.batch_queue import read_result
from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol import messages
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.platform import probe_scene, probes

VALUES = {"gripper": "panda", "evaluations": 60, "overlaps": "redraw", "protocol": "paper"}


def test_a_warm_start_is_measured_beside_a_search_from_nothing(monkeypatch, capsys):
    words = shlex.split("- --sources mug --source-evaluations 60 --objects tennis_ball --evaluations 60")
    monkeypatch.setattr("sys.argv", words)
    monkeypatch.setattr(warm_start, "MILESTONES", (30, 60, 1000))
    warm_start.main()
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["handed_on"], line["evaluations"]) for line in lines] == [
        ("nothing", [30, 60]),
        ("all", [30, 60]),
    ]
    assert all(line["genomes"][1] >= 60 > line["cells_that_hold"][1] > 0 for line in lines)


@pytest.fixture(scope="module")
def profile() -> StageProfile:
    found = StageProfile()
    with Evaluator(probe_scene()) as evaluator, found.profiling(len(probes())):
        evaluator.evaluate("approach", probes(), np.zeros(len(probes()), np.uint16))
    return found


def test_the_stages_of_an_evaluation_add_up_to_it(profile: StageProfile) -> None:
    stages = profile.stages(1000.0)
    assert sum(stages.values()) == pytest.approx(1000.0)
    assert {name.removesuffix(STEPS) for name in stages} <= set(ORDER)
    assert {"decode", "overlap filter", "place, overlap", "closing", "shake z", REST} <= set(stages)


def test_the_steps_of_a_stage_are_told_from_the_rest_of_it(profile: StageProfile) -> None:
    stages = profile.stages(1.0)
    assert stages[f"closing{STEPS}"] + stages[f"shake z{STEPS}"] <= profile.step_share < 1.0
    assert 0 < profile.steps_each < 509


def test_nothing_is_profiled_afterwards(profile: StageProfile) -> None:
    assert not any(hasattr(getattr(owner, name), "__wrapped__") for owner, name, _ in STAGES)


def test_of_what_is_within_something_else_the_inner_one_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 4.0, 4.5, 7.0, 7.5])
    monkeypatch.setattr("benchmarks.measure.time.process_time", lambda: next(clock))
    timer = StageTimer()
    with timer.within("outer"):
        with timer.within("inner"):
            assert timer.current == "inner"
        with timer.within("inner"):
            pass
    assert timer.seconds == {"outer": 1.0 + 0.5 + 0.5, "inner": 3.0 + 2.5}
    assert timer.total == 7.5


class Steady:
    """Takes the same time for so many things."""

    remark = ""

    def __init__(self, count: int) -> None:
        self.count = count
        self.stages = {"all": 1.0}

    def __call__(self, meter: Meter) -> float:
        meter.seconds += 0.25
        return self.count


def test_what_is_compared_has_its_turns_and_its_ratios_are_those_of_each_round() -> None:
    first, second = measure_in_turns(
        [TimedWork("one", Steady(10)), TimedWork("two", Steady(30))], 5.0, rounds=5
    )
    assert first.rates == (40.0,) * 5
    assert second.ratios(first) == (3.0,) * 5
    assert (second.count, second.seconds) == (600, 5.0)
    assert second.ratios(Figure("once", 30, 2.0)) == (8.0,)


@pytest.mark.parametrize(
    ("values", "words"),
    [((1234567.0,), "1,230,000"), ((0.01234, 0.01234), "0.0123 [0.0123, 0.0123]"), ((99.96,), "100")],
)
def test_numbers_are_given_to_three_figures(values: tuple[float, ...], words: str) -> None:
    assert spread(values) == words
    assert number(values[0]) == words.split()[0]


def test_every_pair_is_measured_once_and_the_built_in_ones_are_there() -> None:
    pairs = [pair[:2] for pair in BUILT_IN + REFERENCE]
    assert len(set(pairs)) == len(pairs)
    assert {pair.hand for pair in BUILT_IN} <= set(gripper_names())
    assert {pair.object for pair in BUILT_IN} <= set(object_names())


def test_the_figure_has_a_bar_for_each_regime_of_each_pair(tmp_path) -> None:
    stages = {"decode": 10.0, f"closing{STEPS}": 60.0, "closing": 5.0, "rest": 25.0}
    figures = [
        Figure(f"{pair}, {regime}", 1, 1e-4, stages=stages)
        for pair in ("panda on mug", "shadow on mug")
        for regime in ("anywhere", "near grasps")
    ]
    sheet = figure.draw(figures)
    assert len(sheet.figure.axes) == 2
    for axes in sheet.figure.axes:
        widths = [bar.get_width() for bar in axes.patches]
        assert sum(widths) == pytest.approx(2.0)
        assert {text.get_text() for text in axes.texts} >= {"100 µs"}
    assert [path.suffix for path in sheet.write(tmp_path / figure.NAME)] == [".png", ".svg"]


def test_every_counted_evaluation_has_one_class_of_outcome() -> None:
    rows = random_rows(200, seed=3)
    known = np.unique(cells(rows["descriptor"][:, :3]), axis=0)[::2]
    reference = ReferenceSet("block", known, np.full(len(known), 2, np.uint8))
    told = list(limits.shares(rows, reference, evaluation_mask(rows, "count")))
    assert [share.until for share in told] == [40, 80, 120, 160, 200]
    for share in told:
        parts = (share.not_simulated, share.no_contact, share.known, share.elsewhere, share.new)
        assert sum(parts) == pytest.approx(100)
    found = {tuple(cell) for cell in cells(successes(rows)["descriptor"][:, :3]).tolist()}
    left = [cell for cell in known.tolist() if tuple(cell) not in found]
    assert limits.unfound_cells(rows, reference).cells == pytest.approx(100 * len(left) / len(known))
    assert sum(share.new for share in told) * 40 / 100 == pytest.approx(len(known) - len(left))


WID = "0" * 32


def test_a_prepared_result_answers_the_batch_that_it_is_filled_in_for() -> None:
    answers = PreparedResults(3, WID, epoch=2, n=5, seconds=0.5, key=bytes(32))
    results = [
        messages.decode(answers.next_for(f"run-{number}", number, bytes([number]) * 16, number + 1), Result)
        for number in range(VARIETY)
    ]
    assert [(each.run, each.generation, each.batch[0], each.attempt) for each in results] == [
        (f"run-{number}", number, number, number + 1) for number in range(VARIETY)
    ]
    assert all((each.epoch, each.wid, each.n, each.failures) == (2, WID, 5, []) for each in results)
    read = [read_result(each, SHAPE)[1] for each in results]
    assert len({found["descriptor"].tobytes() for found in read}) == VARIETY


def test_prepared_rows_are_of_every_kind_that_random_poses_are_of() -> None:
    found = rows(1000, np.random.default_rng(0))
    assert set(np.unique(found["outcome"])) == {Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD}
    np.testing.assert_array_equal(found["fitness"] == 2, found["outcome"] == Outcome.HELD)


@pytest.mark.parametrize("seconds", [0.0, 0.01])
def test_a_coordinator_is_measured_while_stand_ins_answer(seconds: float) -> None:
    runs = [make_run_plan("run", spec("contact_rand", 4 * BATCH), ConstantSearch(4 * BATCH), 2)]
    with (
        router() as (endpoint, pid),
        start_stand_ins([StandInGroup(endpoint, JOB, 2, seconds=seconds)]) as stand_ins,
    ):
        measurement = CoordinatorMeasurement(stand_ins, runs, 0.0, 1.0)
        memory: list[int] = []
        measurement.at_join = lambda: memory.append(resident(pid))
        coordinate(endpoint, runs, lambda _: lambda run: PlatformSink(run.shape), measurement, BATCH)
    found = measurement.window
    assert found.batches > 0
    assert found.rows <= runs[0].pipeline.tally.rows
    assert found.cpu_seconds > 0
    assert memory[0] > 0


def test_a_coordinator_is_compared_with_itself_beside_monitors() -> None:
    endpoint = own_endpoint()
    with monitors(endpoint, 2, stopped=1) as clients:
        (pair,) = measure_window_pairs(lambda: TimedBus.router(endpoint), endpoint, clients, 1, 1.5)
    assert pair.without_clients.per_batch > 0
    assert pair.with_clients.monitor_rate > 0
    figures = list(compared([pair], "them"))
    assert figures[0].value == pair.with_clients.per_batch / pair.without_clients.per_batch


def test_pyribs_share_of_a_search_is_a_part_of_it() -> None:
    asked = spec("cma_mae", 60)
    search = ProfiledSearch(method(asked.method).build(asked, plain(SHAPE.genes)))
    for generation in range(3):
        told = rows(60, np.random.default_rng(generation))
        told["genome"] = search.ask(generation)
        search.tell(generation, told)
    assert search.rows == 3 * 60
    assert 0 < search.ribs.seconds < search.whole.seconds


def test_a_run_that_is_put_back_is_the_next_one() -> None:
    asked = spec("contact_rand", 20)
    built = [
        make_run_plan(name, asked, method(asked.method).build(asked, plain(SHAPE.genes))) for name in "ab"
    ]
    queue = GivenRuns(built)
    assert queue.next() is built[0]
    queue.put_back("a")
    assert [queue.next() for _ in range(3)] == [*built, None]


@pytest.mark.parametrize(
    ("bounds", "is_met"),
    [({}, None)]
    + [({"least": bound}, bound < 2) for bound in (1.0, 3.0)]
    + [({"most": bound}, bound > 2) for bound in (1.0, 3.0)],
)
def test_a_figure_is_met_within_what_is_wanted(bounds: dict[str, float], is_met: bool | None) -> None:
    assert ScaleFigure("a", 2.0, "s", **bounds).is_met is is_met


@pytest.mark.parametrize("processes", [1, 2])
def test_work_side_by_side_has_all_results_and_says_what_fails(processes: int) -> None:
    assert sorted(side_by_side(math.sqrt, [9.0, 1.0, 4.0], processes)) == [(1.0, 1.0), (4.0, 2.0), (9.0, 3.0)]
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        list(side_by_side(math.sqrt, [-1.0], processes))
    begun = side_by_side(math.sqrt, map(float, range(200)), processes)
    next(begun)
    begun.close()
