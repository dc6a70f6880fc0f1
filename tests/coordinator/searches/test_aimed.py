"""The search that aims, on a make-believe object."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.searches.make_believe import covered, evaluate, play, shape, space

from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.searches import aimed, spare
from qdgrasp_coordinator.searches.aimed import START, Aimed
from qdgrasp_coordinator.searches.aims import CANDIDATES, CONTACT, LOOSENESS, TARGET
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec

SPACE = space("aimed")
HAND = space("aimed", ("synergy", "spread"))
ELSEWHERE = "from tests.coordinator.searches.test_aimed import digest; print(digest())"


def spec(**values) -> RunSpec:
    defaults = {"gripper": "hand", "object": "thing", "population": 50, "overlaps": "redraw"}
    return RunSpec(**defaults | values)


def search(**values) -> Aimed:
    return Aimed(spec(**values), SPACE)


def digest() -> str:
    """The sha256 over what is asked and told in 1000 evaluations."""
    return hashlib.sha256(play(Aimed(spec(), HAND), HAND, 1000).tobytes()).hexdigest()


def targets(rows: Rows) -> np.ndarray:
    return SPACE.layout.values(rows["genome"])[:, TARGET]


def test_a_fresh_process_asks_the_same_bits() -> None:
    command = [sys.executable, "-c", ELSEWHERE]
    home = Path(__file__).parents[3]
    there = subprocess.run(command, check=True, capture_output=True, text=True, timeout=200, cwd=home)
    assert there.stdout.strip() == digest()


@pytest.mark.parametrize("in_flight", [1, 2])
def test_a_run_that_was_stopped_goes_on_to_the_same_journal(in_flight: int) -> None:
    def pipeline() -> Pipeline:
        return Pipeline(Aimed(spec(seed=3), HAND), shape(HAND), 700, "redraw", in_flight)

    def journal(running: Pipeline, last_first: bool = False) -> Rows:
        pieces = []
        while running.finished is None:
            asked = []
            while (generation := running.ask()) is not None:
                rows = evaluate(HAND, generation.number, generation.genomes)
                rows["index"] = generation.indices
                asked.append(rows)
            pieces += [running.settle(rows).rows for rows in (asked[::-1] if last_first else asked)]
        return np.concatenate(pieces)

    whole = journal(pipeline())
    assert journal(pipeline(), last_first=True).tobytes() == whole.tobytes()
    resumed = pipeline()
    resumed.replay(whole[:333])
    assert journal(resumed).tobytes() == whole[333:].tobytes()


def test_it_covers_ten_times_the_cells_of_map_elites() -> None:
    rows = play(search(), SPACE, 1500)
    other = space("contact")
    elites = method("contact_me_scs").build(spec(population=500), other)
    assert covered(rows) > 10 * covered(play(elites, other, 1500))


def test_nearly_every_success_is_a_new_cell() -> None:
    rows = play(search(), SPACE, 1500)
    assert covered(rows) > 0.9 * np.count_nonzero(rows["outcome"] >= Outcome.DROPPED)


def test_with_one_candidate_it_still_covers_more_when_overlaps_count() -> None:
    counting = spec(overlaps="count")
    rows = play(Aimed(counting, SPACE), SPACE, 2000, "count")
    assert (SPACE.layout.values(rows["genome"])[:, CANDIDATES] == 1).all()
    assert (SPACE.layout.values(rows["genome"])[:, LOOSENESS] == 0).mean() > 0.9
    other = space("contact")
    elites = method("contact_me_scs").build(spec(population=500, overlaps="count"), other)
    assert covered(rows) > 1.5 * covered(play(elites, other, 2000, "count"))


@pytest.mark.parametrize("population", [1, 50, 500])
def test_any_population_finds_its_way(population: int) -> None:
    rows = play(search(population=population), SPACE, 600)
    assert len(rows) % population == 0
    assert covered(rows) > (100 if population == 500 else 300)


def test_no_target_lies_outside_the_box() -> None:
    rows = play(search(), SPACE, 2000)
    low, high = SPACE.box
    assert (targets(rows) >= low).all()
    assert (targets(rows) <= high).all()
    assert np.abs(rows["genome"]).max() <= 1


def test_it_aims_at_empty_cells_beside_successes() -> None:
    seeking = search()
    found: set[tuple[int, ...]] = set()
    for generation in range(12):
        rows = evaluate(SPACE, generation, seeking.ask(generation))
        tight = rows[SPACE.layout.values(rows["genome"])[:, LOOSENESS] == 0]
        for cell in map(tuple, cells(targets(tight))):
            steps = np.array(list(found)) - cell
            assert cell not in found
            assert np.abs(steps).max(axis=1).min() == 1
        assert len(np.unique(cells(targets(tight)), axis=0)) == len(tight)
        seeking.tell(generation, rows)
        good = rows[rows["outcome"] >= Outcome.DROPPED]["descriptor"][:, :3]
        found |= set(map(tuple, cells(good)))
    assert len(tight) > 45


def test_where_every_pose_counts_hands_stand_as_far_from_the_hint_as_they_can() -> None:
    rows = play(search(overlaps="count"), SPACE, 2000)
    values = SPACE.layout.values(rows["genome"])[START:]
    distances = np.linalg.norm(values[:, TARGET] - values[:, CONTACT], axis=1)
    least, greatest = SPACE.distances
    scatter = 0.005
    assert ((distances > least - scatter) & (distances < greatest + scatter)).mean() > 0.98


def test_the_beginning_and_a_few_later_genomes_scout() -> None:
    rows = play(search(), SPACE, 2000)
    loose = SPACE.layout.values(rows["genome"])[:, LOOSENESS] > 0
    assert loose[:START].all()
    assert 0.01 < loose[1000:].mean() < 0.1


@pytest.mark.parametrize("outcome", [Outcome.ERROR, Outcome.DEAD_END, Outcome.OVERLAP, Outcome.MISSED])
def test_without_a_success_it_scouts_on_and_goes_astray(outcome: Outcome) -> None:
    seeking, asked = search(), []
    for generation in range(60):
        rows = evaluate(SPACE, generation, seeking.ask(generation))
        rows["outcome"] = outcome
        seeking.tell(generation, rows)
        asked.append(rows)
    rows = np.concatenate(asked)
    looseness = SPACE.layout.values(rows["genome"])[:, LOOSENESS]
    assert (looseness > 0).all()
    assert (looseness[:200] == 1).mean() < 0.1
    assert (looseness[-500:] == 1).mean() == pytest.approx(0.5, abs=0.1)
    assert len(np.unique(rows["genome"], axis=0)) == len(rows)


def test_dead_ends_are_not_tried_for_ever() -> None:
    """One cell in three is a dead end, whatever is tried there."""
    seeking, told = search(), []
    for generation in range(80):
        rows = evaluate(SPACE, generation, seeking.ask(generation))
        rows["outcome"][cells(targets(rows)).sum(axis=1) % 3 == 0] = Outcome.DEAD_END
        seeking.tell(generation, rows)
        told.append(rows)
    rows = np.concatenate(told)
    aimed_at, times = np.unique(cells(targets(rows)), axis=0, return_counts=True)
    dead = aimed_at.sum(axis=1) % 3 == 0
    assert times[dead].max() < 30
    assert covered(rows) > 450


def test_synergies_are_inherited_but_for_some_and_free_joints_drift() -> None:
    seeking = Aimed(spec(), HAND)
    parents = np.tile(np.array([[0.5, -1.0]]), (4000, 1))
    children = seeking._varied(parents, np.random.default_rng(0))
    assert (children[:, 0] != 0.5).mean() == pytest.approx(aimed.REDRAWN, abs=0.03)
    assert np.abs(children).max() <= 1
    assert 0 < (children[:, 1] + 1).mean() < 0.05


def test_weak_grasps_are_tried_again_where_that_is_worth_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def again(value: float) -> float:
        monkeypatch.setattr(spare, "VALUE", value)
        rows = play(search(), SPACE, 1000)
        first = np.unique(cells(rows["descriptor"][rows["outcome"] >= Outcome.DROPPED][:, :3]), axis=0)
        return np.count_nonzero(rows["outcome"] >= Outcome.DROPPED) / len(first)

    assert again(0.0) < 1.05
    assert again(100.0) > 1.2
