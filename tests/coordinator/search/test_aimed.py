"""The search that aims, on a make-believe object."""

import hashlib

import numpy as np
import pytest
from tests.coordinator.search.synthetic_scene import (
    DEEPEST,
    PALM,
    SIZE,
    covered,
    evaluate,
    play,
    shape,
    space,
)

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.search import aimed
from qdgrasp_coordinator.search.aimed import (
    CANDIDATES,
    CONTACT,
    FIRST_SCOUTS,
    LOOSENESS,
    PRIOR_PROMISES,
    RETRY_SHARE,
    TARGET,
    AimedGrasps,
    AimedSearch,
    RetryBudget,
    directions,
    exploration_grasps,
    scatter_grasps,
)
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_coordinator.search.frontier import EliteStore, Frontier, Places
from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

SPACE = space("aimed")
HAND = space("aimed", ("synergy", "spread"))


def spec(**values) -> RunSpec:
    defaults = {"gripper": "hand", "object": "thing", "population": 50, "overlaps": "redraw"}
    return RunSpec(**defaults | values)


def search(**values) -> AimedSearch:
    return AimedSearch(spec(**values), SPACE)


def digest() -> str:
    """The sha256 over what is asked and told in 1000 evaluations."""
    return hashlib.sha256(play(AimedSearch(spec(), HAND), HAND, 1000).tobytes()).hexdigest()


def targets(rows: Rows) -> np.ndarray:
    return SPACE.layout.values(rows["genome"])[:, TARGET]


@pytest.mark.parametrize("in_flight", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_run_that_was_stopped_goes_on_to_the_same_journal(in_flight: int) -> None:
    def pipeline() -> Pipeline:
        return Pipeline(AimedSearch(spec(seed=3), HAND), shape(HAND), 700, "redraw", in_flight)

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
    rows = play(AimedSearch(counting, SPACE), SPACE, 2000, "count")
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
    values = SPACE.layout.values(rows["genome"])[FIRST_SCOUTS:]
    distances = np.linalg.norm(values[:, TARGET] - values[:, CONTACT], axis=1)
    least, greatest = SPACE.distances
    scatter = 0.005
    assert ((distances > least - scatter) & (distances < greatest + scatter)).mean() > 0.98


def test_the_beginning_and_a_few_later_genomes_scout() -> None:
    rows = play(search(), SPACE, 2000)
    loose = SPACE.layout.values(rows["genome"])[:, LOOSENESS] > 0
    assert loose[:FIRST_SCOUTS].all()
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
    seeking = AimedSearch(spec(), HAND)
    parents = np.tile(np.array([[0.5, -1.0]]), (4000, 1))
    children = seeking._varied(parents, np.random.default_rng(0))
    assert (children[:, 0] != 0.5).mean() == pytest.approx(aimed.SYNERGY_REDRAW, abs=0.03)
    assert np.abs(children).max() <= 1
    assert 0 < (children[:, 1] + 1).mean() < 0.05


def test_weak_grasps_are_tried_again_where_that_is_worth_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def again(value: float) -> float:
        monkeypatch.setattr(aimed, "RETRY_VALUE", value)
        rows = play(search(), SPACE, 1000)
        first = np.unique(cells(rows["descriptor"][rows["outcome"] >= Outcome.DROPPED][:, :3]), axis=0)
        return np.count_nonzero(rows["outcome"] >= Outcome.DROPPED) / len(first)

    assert again(0.0) < 1.05
    assert again(100.0) > 1.2


def test_scattered_aims_stay_in_their_cells_and_are_all_different() -> None:
    n = 500
    whole = np.random.default_rng(1).integers(-20, 20, (n, 3)) / 100
    aims = AimedGrasps(whole, np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros((n, 2)))
    beside = scatter_grasps(aims, np.random.default_rng(0))
    assert (cells(beside.targets) == cells(whole)).all()
    for column in (beside.targets - whole, beside.contacts, beside.rolls[:, None]):
        assert len(np.unique(column, axis=0)) == n
    assert np.abs(beside.contacts).max() < 0.015


def drawn(astray: float, n: int = 2000) -> AimedGrasps:
    return exploration_grasps(SPACE, n, astray, 1.0, np.random.default_rng(0))


def distances(aims: AimedGrasps) -> np.ndarray:
    return np.linalg.norm(aims.targets - aims.contacts, axis=1)


def test_a_scout_looks_at_a_face_from_before_it() -> None:
    aims = drawn(astray=0.0)
    on_face = np.isclose(np.abs(aims.contacts), SIZE / 2)
    assert on_face.any(axis=1).all()
    towards = directions(aims.targets, aims.contacts)
    inward = -np.sign(aims.contacts) * on_face
    assert ((towards * inward).sum(axis=1) > np.cos(np.pi / 4) - 1e-9).all()


def test_a_scout_stands_in_the_near_half_of_where_the_hand_can_stand() -> None:
    found = distances(drawn(astray=0.0))
    assert found.min() == pytest.approx(PALM, abs=1e-4)
    assert found.max() == pytest.approx(PALM + DEEPEST / 2, abs=1e-4)


def test_those_that_go_astray_aim_anywhere_in_the_box() -> None:
    low, high = SPACE.box
    found = (drawn(astray=1.0).targets - low) / (high - low)
    assert np.abs(found.mean(axis=0) - 0.5).max() < 0.05
    assert found.min() < 0.01
    assert found.max() > 0.99


BOX = (np.full(3, -0.05), np.full(3, 0.05))
BLOCK = np.stack(np.meshgrid(*[[-0.01, 0.0, 0.01]] * 3), axis=-1).reshape(-1, 3)
MIDDLE = np.zeros((1, 3))


class Found:
    """A search's cells, as far as successes are heard of."""

    def __init__(self) -> None:
        self.frontier = Frontier(BOX, 0.1)
        self.elites = EliteStore(self.frontier.size, (0.0, 0.0, 1.0), 0)
        self.retries = RetryBudget(self.frontier, self.elites)

    def succeed(self, positions: np.ndarray, outcome: Outcome) -> Places:
        """Add a success in each of the cells at `positions` (n, 3), after one try in each."""
        rows = RowShape(genes=15, joints=1, descriptors=9).empty(len(positions))
        rows["outcome"], rows["base_to_object"][:, 6] = outcome, 1
        places = self.frontier.places(positions)
        self.frontier.count_tries(places)
        self.frontier.add_successes(places, positions - [0.0, 0.0, 0.05])
        self.elites.offer(places, rows)
        if outcome == Outcome.HELD:
            self.retries.add_robust(places)
        return places

    def ask(self, generation: int = 0) -> Places:
        return self.retries.ask(generation, keyed_generator(0, "targets", generation))

    def tell(self, generation: int, *, robust: bool, counts: bool = True) -> None:
        """Tell a generation at whose frontier nothing succeeded."""
        self.retries.tell(generation, np.zeros(10, np.bool_), np.tile([counts, robust], (3, 1)))

    def frontier_gives(self, share: float) -> None:
        """Tell many generations of ten tries in empty cells."""
        for _ in range(100):
            self.retries.tell(-1, np.arange(10) < share * 10, np.zeros((0, 2), np.bool_))


@pytest.fixture
def found() -> Found:
    return Found()


def around(n: int) -> np.ndarray:
    """The first `n` cells around the middle."""
    return BLOCK[(BLOCK != 0).any(axis=1)][:n]


@pytest.fixture
def weak(found: Found) -> Places:
    """A weak cell whose neighbours all are robust."""
    found.succeed(around(26), Outcome.HELD)
    return found.succeed(MIDDLE, Outcome.SHAKEN)


@pytest.mark.parametrize("n", [0, 1, 13, 26])
def test_a_weak_cell_is_worth_the_share_of_its_neighbours_that_are_robust(found: Found, n: int) -> None:
    found.succeed(around(n), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    assert found.retries.worth(weak).tolist() == [n / 26]


def test_a_cell_that_is_robust_again_counts_once(found: Found) -> None:
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    for _ in range(3):
        found.succeed(np.repeat(around(1), 2, axis=0), Outcome.HELD)
    assert found.retries.worth(weak).tolist() == [1 / 26]


def test_every_try_makes_the_next_one_less_worth(found, weak) -> None:
    found.frontier.count_tries(weak)
    assert found.retries.worth(weak).tolist() == [1 / 2]


@pytest.mark.parametrize(("share", "tries"), [(1.0, 0), (0.4, 0), (0.3, 1), (0.0, 1)])
def test_weak_cells_are_tried_where_that_is_more_than_the_frontier_gives(found, weak, share, tries) -> None:
    found.frontier_gives(share)
    assert found.ask().tolist() == weak.tolist() * tries


def test_before_anything_was_tried_the_frontier_is_taken_to_be_rich(found, weak) -> None:
    assert len(found.ask()) == 0


def test_robust_cells_and_those_without_a_robust_neighbour_are_left_alone(found: Found) -> None:
    found.succeed(around(26), Outcome.SHAKEN)
    found.frontier_gives(0.0)
    assert len(found.ask()) == 0
    found.succeed(BLOCK, Outcome.HELD)
    assert len(found.ask()) == 0


def test_the_most_promising_go_first_and_no_more_than_half_of_what_the_frontier_has(found: Found) -> None:
    found.succeed(BLOCK[BLOCK[:, 0] < 0], Outcome.HELD)
    weak = found.succeed(BLOCK[BLOCK[:, 0] >= 0], Outcome.SHAKEN)
    found.frontier_gives(0.0)
    asked = found.ask()
    assert 4 <= len(asked) <= RETRY_SHARE * 10
    assert found.retries.worth(asked).min() >= np.sort(found.retries.worth(weak))[-len(asked)]
    assert len(np.unique(asked)) == len(asked)


@pytest.mark.parametrize("gave", [0.0, 0.5, 1.0])
def test_what_tries_gave_corrects_what_they_promise(found, weak, gave) -> None:
    found.frontier_gives(0.0)
    for generation in range(200):
        assert len(found.ask(generation)) == 1
        found.tell(generation, robust=generation < gave * 200)
    assert found.retries.worth(weak)[0] == pytest.approx(
        (PRIOR_PROMISES + gave * 200) / (PRIOR_PROMISES + 200)
    )


def test_rows_that_no_retry_asked_for_correct_nothing(found, weak) -> None:
    found.tell(0, robust=False)
    assert found.retries.worth(weak).tolist() == [1.0]


def test_tries_that_do_not_count_correct_nothing(found, weak) -> None:
    found.frontier_gives(0.0)
    assert len(found.ask()) == 1
    found.tell(0, robust=False, counts=False)
    assert found.retries.worth(weak).tolist() == [1.0]


def test_without_a_value_nothing_is_tried_again(found, weak, monkeypatch) -> None:
    monkeypatch.setattr(aimed, "RETRY_VALUE", 0.0)
    found.frontier_gives(0.0)
    assert len(found.ask()) == 0
