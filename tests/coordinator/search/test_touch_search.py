"""The search that aims at touch, on a make-believe object, and its second tries."""

import numpy as np
import pytest
from tests.coordinator.search.synthetic_scene import covered, evaluate, play, space
from tests.coordinator.search.test_aimed import spec, targets

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.search import touch_search
from qdgrasp_coordinator.search.aimed import LOOSENESS
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_coordinator.search.frontier import EliteStore, Places, outcome_ranks
from qdgrasp_coordinator.search.registry import method
from qdgrasp_coordinator.search.touch_search import (
    PRIOR_PROMISES,
    RETRY_SHARE,
    RetryBudget,
    TouchFrontier,
    TouchSearch,
)
from qdgrasp_protocol.rows import Outcome, RowShape

SPACE = space("aimed")


def search() -> TouchSearch:
    return TouchSearch(spec(aim_for="touch"), SPACE)


def test_it_covers_ten_times_the_cells_of_map_elites() -> None:
    rows = play(search(), SPACE, 1500)
    other = space("contact")
    elites = method("contact_me_scs").build(spec(population=500), other)
    assert covered(rows) > 10 * covered(play(elites, other, 1500))


def test_nearly_every_success_is_a_new_cell() -> None:
    rows = play(search(), SPACE, 1500)
    assert covered(rows) > 0.9 * np.count_nonzero(rows["outcome"] >= Outcome.DROPPED)


def test_it_aims_at_empty_cells_beside_successes() -> None:
    seeking = search()
    found: set[tuple[int, ...]] = set()
    for generation in range(12):
        rows = evaluate(SPACE, generation, seeking.ask(generation))
        tight = rows[SPACE.layout.values(rows["genome"])[:, LOOSENESS] == 0]
        for cell in map(tuple, cells(targets(SPACE, tight))):
            steps = np.array(list(found)) - cell
            assert cell not in found
            assert np.abs(steps).max(axis=1).min() == 1
        assert len(np.unique(cells(targets(SPACE, tight)), axis=0)) == len(tight)
        seeking.tell(generation, rows)
        good = rows[rows["outcome"] >= Outcome.DROPPED]["descriptor"][:, :3]
        found |= set(map(tuple, cells(good)))
    assert len(tight) > 45


def test_weak_grasps_are_tried_again_where_that_is_worth_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def again(value: float) -> float:
        monkeypatch.setattr(touch_search, "RETRY_VALUE", value)
        rows = play(search(), SPACE, 1000)
        first = np.unique(cells(rows["descriptor"][rows["outcome"] >= Outcome.DROPPED][:, :3]), axis=0)
        return np.count_nonzero(rows["outcome"] >= Outcome.DROPPED) / len(first)

    assert again(0.0) < 1.05
    assert again(100.0) > 1.2


BOX = (np.full(3, -0.05), np.full(3, 0.05))
BLOCK = np.stack(np.meshgrid(*[[-0.01, 0.0, 0.01]] * 3), axis=-1).reshape(-1, 3)
MIDDLE = np.zeros((1, 3))


class Found:
    """A search's cells, as far as successes are heard of."""

    def __init__(self) -> None:
        self.frontier = TouchFrontier(BOX, 0.1)
        self.elites = EliteStore(self.frontier.size, (0.0, 0.0, 1.0), 0)
        self.retries = RetryBudget(self.frontier, self.elites)

    def succeed(self, positions: np.ndarray, outcome: Outcome) -> Places:
        """Add a success in each of the cells at `positions` (n, 3), after one try in each."""
        rows = RowShape(genes=15, joints=1, descriptors=9).empty(len(positions))
        rows["outcome"], rows["base_to_object"][:, 6] = outcome, 1
        places = self.frontier.places(positions)
        self.frontier.count_tries(places)
        self.frontier.add_successes(places, positions - [0.0, 0.0, 0.05])
        self.elites.offer(places, rows, outcome_ranks(rows))
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
    assert found.retries.worth(found.succeed(MIDDLE, Outcome.SHAKEN)).tolist() == [n / 26]


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
    monkeypatch.setattr(touch_search, "RETRY_VALUE", 0.0)
    found.frontier_gives(0.0)
    assert len(found.ask()) == 0
