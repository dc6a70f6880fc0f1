"""Second tries in cells whose grasp is weak."""

import numpy as np
import pytest

from qdgrasp_coordinator.draws import draws
from qdgrasp_coordinator.searches import spare
from qdgrasp_coordinator.searches.frontier import Frontier, Places
from qdgrasp_coordinator.searches.hints import Hints
from qdgrasp_coordinator.searches.spare import AGAIN, TRUST, Spare
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Shape

BOX = (np.full(3, -0.05), np.full(3, 0.05))
BLOCK = np.stack(np.meshgrid(*[[-0.01, 0.0, 0.01]] * 3), axis=-1).reshape(-1, 3)
MIDDLE = np.zeros((1, 3))


class Found:
    """A search's cells, as far as successes are heard of."""

    def __init__(self) -> None:
        self.frontier = Frontier(BOX, 0.1)
        self.hints = Hints(self.frontier.size, (0.0, 0.0, 1.0), 0)
        self.spare = Spare(self.frontier, self.hints)

    def succeed(self, positions: np.ndarray, outcome: Outcome) -> Places:
        """Hear of a success in each of the cells at `positions` (n, 3), after one try in each."""
        rows = Shape(genes=15, joints=1, descriptors=9).empty(len(positions))
        rows["outcome"], rows["base_to_object"][:, 6] = outcome, 1
        places = self.frontier.places(positions)
        self.frontier.aim(places)
        self.frontier.succeed(places, positions - [0.0, 0.0, 0.05])
        self.hints.learn(places, rows)
        if outcome == Outcome.HELD:
            self.spare.succeed(places)
        return places

    def ask(self, n: int = 40, generation: int = 0) -> Places:
        generator = draws(0, "targets", generation)
        return self.spare.ask(generation, self.frontier.best(n, generator), generator)

    def spend(self) -> None:
        """Many tries in every empty cell."""
        for _ in range(100):
            self.frontier.aim(self.frontier.edge)


@pytest.fixture
def found() -> Found:
    return Found()


def around(n: int) -> np.ndarray:
    """The first `n` cells around the middle."""
    return BLOCK[(BLOCK != 0).any(axis=1)][:n]


@pytest.mark.parametrize("n", [0, 1, 13, 26])
def test_a_weak_cell_is_worth_the_share_of_its_neighbours_that_are_robust(found: Found, n: int) -> None:
    found.succeed(around(n), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    assert found.spare.worth(weak).tolist() == [n / 26]


def test_a_cell_that_is_robust_again_counts_once(found: Found) -> None:
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    for _ in range(3):
        found.succeed(np.repeat(around(1), 2, axis=0), Outcome.HELD)
    assert found.spare.worth(weak).tolist() == [1 / 26]


def test_every_try_makes_the_next_one_less_worth(found: Found) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.frontier.aim(weak)
    assert found.spare.worth(weak).tolist() == [1 / 2]


def test_a_rich_frontier_is_tried_first_and_a_spent_one_is_not(found: Found) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    assert len(found.ask()) == 0
    found.spend()
    assert found.ask().tolist() == weak.tolist()


def test_robust_cells_and_those_without_a_robust_neighbour_are_left_alone(found: Found) -> None:
    found.succeed(around(26), Outcome.SHAKEN)
    found.spend()
    assert len(found.ask()) == 0
    found.succeed(BLOCK, Outcome.HELD)
    assert len(found.ask()) == 0


def test_the_most_promising_go_first_and_to_a_share_at_most(found: Found) -> None:
    found.succeed(BLOCK[BLOCK[:, 0] < 0], Outcome.HELD)
    weak = found.succeed(BLOCK[BLOCK[:, 0] >= 0], Outcome.SHAKEN)
    found.spend()
    asked = found.ask(n=10)
    assert len(asked) == AGAIN * 10
    assert found.spare.worth(asked).min() >= np.sort(found.spare.worth(weak))[-len(asked)]
    assert len(np.unique(asked)) == len(asked)


@pytest.mark.parametrize("gave", [0.0, 0.5, 1.0])
def test_what_tries_gave_corrects_what_they_promise(found: Found, gave: float) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.spend()
    for generation in range(200):
        found.spare.tell(generation, np.full(3, generation < gave * 200), np.ones(3, np.bool_))
    assert found.spare.worth(weak).tolist() == [1.0]  # nothing was asked
    for generation in range(200):
        assert len(found.ask(generation=generation)) == 1
        found.spare.tell(generation, np.full(3, generation < gave * 200), np.ones(3, np.bool_))
    assert found.spare.worth(weak)[0] == pytest.approx((TRUST + gave * 200) / (TRUST + 200), rel=0.1)


def test_tries_that_do_not_count_correct_nothing(found: Found) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.spend()
    found.ask()
    found.spare.tell(0, np.zeros(1, np.bool_), np.zeros(1, np.bool_))
    assert found.spare.worth(weak).tolist() == [1.0]


def test_without_a_value_nothing_is_tried_again(found: Found, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spare, "VALUE", 0.0)
    found.succeed(around(26), Outcome.HELD)
    found.succeed(MIDDLE, Outcome.SHAKEN)
    found.spend()
    assert len(found.ask()) == 0
