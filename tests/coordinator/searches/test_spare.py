"""Second tries in cells whose grasp is weak."""

import numpy as np
import pytest

from qdgrasp_coordinator.searches import spare
from qdgrasp_coordinator.searches.draws import draws
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

    def ask(self, generation: int = 0) -> Places:
        return self.spare.ask(generation, draws(0, "targets", generation))

    def tell(self, generation: int, *, robust: bool, counts: bool = True) -> None:
        """Hear of a generation at whose frontier nothing succeeded."""
        self.spare.tell(generation, np.zeros(10, np.bool_), np.tile([counts, robust], (3, 1)))

    def frontier_gives(self, share: float) -> None:
        """Hear of many generations of ten tries in empty cells."""
        for _ in range(100):
            self.spare.tell(-1, np.arange(10) < share * 10, np.zeros((0, 2), np.bool_))


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


@pytest.mark.parametrize(("share", "tries"), [(1.0, 0), (0.4, 0), (0.3, 1), (0.0, 1)])
def test_weak_cells_are_tried_where_that_is_more_than_the_frontier_gives(
    found: Found, share: float, tries: int
) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.frontier_gives(share)
    assert found.ask().tolist() == weak.tolist() * tries


def test_before_anything_was_tried_the_frontier_is_taken_to_be_rich(found: Found) -> None:
    found.succeed(around(26), Outcome.HELD)
    found.succeed(MIDDLE, Outcome.SHAKEN)
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
    assert 4 <= len(asked) <= AGAIN * 10
    assert found.spare.worth(asked).min() >= np.sort(found.spare.worth(weak))[-len(asked)]
    assert len(np.unique(asked)) == len(asked)


@pytest.mark.parametrize("gave", [0.0, 0.5, 1.0])
def test_what_tries_gave_corrects_what_they_promise(found: Found, gave: float) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.frontier_gives(0.0)
    for generation in range(200):
        assert len(found.ask(generation)) == 1
        found.tell(generation, robust=generation < gave * 200)
    assert found.spare.worth(weak)[0] == pytest.approx((TRUST + gave * 200) / (TRUST + 200))


def test_rows_that_no_spare_try_asked_for_correct_nothing(found: Found) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.tell(0, robust=False)
    assert found.spare.worth(weak).tolist() == [1.0]


def test_tries_that_do_not_count_correct_nothing(found: Found) -> None:
    found.succeed(around(26), Outcome.HELD)
    weak = found.succeed(MIDDLE, Outcome.SHAKEN)
    found.frontier_gives(0.0)
    assert len(found.ask()) == 1
    found.tell(0, robust=False, counts=False)
    assert found.spare.worth(weak).tolist() == [1.0]


def test_without_a_value_nothing_is_tried_again(found: Found, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spare, "VALUE", 0.0)
    found.succeed(around(26), Outcome.HELD)
    found.succeed(MIDDLE, Outcome.SHAKEN)
    found.frontier_gives(0.0)
    assert len(found.ask()) == 0
