"""What the benchmarks measure with; their figures are not tested."""

import numpy as np
import pytest
from tests.benchmarks import limits, where
from tests.benchmarks.coordination import METHODS, Coordinator
from tests.benchmarks.evaluations import BUILT_IN, REFERENCE
from tests.benchmarks.ledger import Ledger
from tests.benchmarks.measure import Figure, Meter, Subject, in_turns, number, spread
from tests.benchmarks.stages import ORDER, REST, STAGES, STEPS, Profile
from tests.coordinator.recorded_runs import random_rows

from qdgrasp_assets.catalog import gripper_names, object_names
from qdgrasp_coordinator.analysis.reference import ReferenceSet
from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.counts.tally import counted, successes
from qdgrasp_coordinator.searches.search import METHODS as KNOWN
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.platform import probe_scene, probes


@pytest.fixture(scope="module")
def profile() -> Profile:
    found = Profile()
    with Evaluator(probe_scene()) as evaluator, found.watching(len(probes())):
        evaluator.evaluate("approach", probes(), np.zeros(len(probes()), np.uint16))
    return found


def test_the_stages_of_an_evaluation_add_up_to_it(profile: Profile) -> None:
    stages = profile.stages(1000.0)
    assert sum(stages.values()) == pytest.approx(1000.0)
    assert {name.removesuffix(STEPS) for name in stages} <= set(ORDER)
    assert {"decode", "overlap filter", "place, overlap", "closing", "shake z", REST} <= set(stages)


def test_the_steps_of_a_stage_are_told_from_the_rest_of_it(profile: Profile) -> None:
    stages = profile.stages(1.0)
    assert stages[f"closing{STEPS}"] + stages[f"shake z{STEPS}"] <= profile.step_share < 1.0
    assert 0 < profile.steps_each < 509


def test_nothing_is_watched_afterwards(profile: Profile) -> None:
    assert not any(hasattr(getattr(owner, name), "__wrapped__") for owner, name, _ in STAGES)


def test_of_what_is_within_something_else_the_inner_one_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 4.0, 4.5, 7.0, 7.5])
    monkeypatch.setattr("tests.benchmarks.ledger.time.process_time", lambda: next(clock))
    ledger = Ledger()
    with ledger.within("outer"):
        with ledger.within("inner"):
            assert ledger.inmost == "inner"
        with ledger.within("inner"):
            pass
    assert ledger.seconds == {"outer": 1.0 + 0.5 + 0.5, "inner": 3.0 + 2.5}
    assert ledger.total == 7.5


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
    first, second = in_turns([Subject("one", Steady(10)), Subject("two", Steady(30))], 5.0, rounds=5)
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


@pytest.mark.parametrize("name", METHODS)
def test_a_coordinator_alone_gets_on_with_every_method_that_is_measured(name: str) -> None:
    assert name in KNOWN
    coordinator, meter = Coordinator(name), Meter()
    assert sum(coordinator(meter) for _ in range(3)) > 0
    assert set(coordinator.stages) == {"ask", "tell", "pipeline", "dispatch", "messages"}


def test_the_figure_has_a_bar_for_each_regime_of_each_pair(tmp_path) -> None:
    stages = {"decode": 10.0, f"closing{STEPS}": 60.0, "closing": 5.0, "rest": 25.0}
    figures = [
        Figure(f"{pair}, {regime}", 1, 1e-4, stages=stages)
        for pair in ("panda on mug", "shadow on mug")
        for regime in ("anywhere", "near grasps")
    ]
    sheet = where.draw(figures)
    assert len(sheet.figure.axes) == 2
    for axes in sheet.figure.axes:
        widths = [bar.get_width() for bar in axes.patches]
        assert sum(widths) == pytest.approx(2.0)
        assert {text.get_text() for text in axes.texts} >= {"100 µs"}
    assert [path.suffix for path in sheet.write(tmp_path / where.NAME)] == [".png", ".svg"]


def test_every_counted_evaluation_has_one_fate() -> None:
    rows = random_rows(200, seed=3)
    known = np.unique(cells(rows["descriptor"][:, :3]), axis=0)[::2]
    reference = ReferenceSet("block", known, np.full(len(known), 2, np.uint8))
    told = list(limits.shares(rows, reference, counted(rows, "count")))
    assert [share.until for share in told] == [40, 80, 120, 160, 200]
    for share in told:
        fates = (share.unseated, share.lost, share.known, share.elsewhere, share.new)
        assert sum(fates) == pytest.approx(100)
    found = {tuple(cell) for cell in cells(successes(rows)["descriptor"][:, :3]).tolist()}
    left = [cell for cell in known.tolist() if tuple(cell) not in found]
    assert limits.rest(rows, reference).cells == pytest.approx(100 * len(left) / len(known))
    assert sum(share.new for share in told) * 40 / 100 == pytest.approx(len(known) - len(left))
