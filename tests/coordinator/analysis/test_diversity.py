import numpy as np
import pytest

from qdgrasp_coordinator.analysis.diversity import diversity
from qdgrasp_coordinator.counts.niches import UNKNOWN, NicheArchive, Synergies
from qdgrasp_coordinator.counts.orientations import MIDDLES
from qdgrasp_protocol.genome import Gene, Layout
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

SHAPE = Shape(genes=1, joints=1)
TWO = Synergies(Layout("contact", (Gene("synergy", 0.0, 1.0),)))


def rows(*cells: int) -> Rows:
    made = SHAPE.empty(len(cells))
    made["outcome"], made["base_to_object"][:, 3:] = Outcome.DROPPED, MIDDLES[0]
    made["descriptor"][:, 0] = np.array(cells) / 100
    return made


def archive(found: Rows, synergies: Synergies = TWO) -> NicheArchive:
    made = NicheArchive(synergies)
    made.insert(found)
    return made


def test_orientations_and_synergies_are_counted_in_the_cells_with_a_success() -> None:
    found = rows(0, 0, 0, 0, 1)
    found["base_to_object"][1:3, 3:] = MIDDLES[[4, 5]]
    found["genome"][2:4, 0] = 1.0
    said = diversity(archive(found))
    assert said.niches == 5
    assert said.orientations == (3 + 1) / 2
    assert said.synergies == (2 + 1) / 2


def test_a_niche_counts_by_the_best_in_it() -> None:
    found = rows(0, 0, 1, 1, 2)
    found["outcome"] = [Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN, Outcome.DROPPED, Outcome.DROPPED]
    said = diversity(archive(found, UNKNOWN))
    assert (said.niches, said.grasp_niches, said.robust_niches) == (3, 2, 1)


def test_without_a_success_there_is_no_mean() -> None:
    said = diversity(archive(rows()))
    assert (said.niches, said.orientations, said.synergies, said.words) == (0, None, None, "none")


def test_the_words_hold_all_figures() -> None:
    found = rows(0, 0, 1)
    found["base_to_object"][1, 3:] = MIDDLES[4]
    found["outcome"] = Outcome.HELD
    said = diversity(archive(found)).words
    assert said == "3 niches, 3 with a grasp, 3 robust; 1.50 orientations and 1.00 synergies in a cell"


@pytest.mark.parametrize("n", [0, 300])
def test_niches_are_never_fewer_than_cells_and_never_more_than_successes(n: int) -> None:
    random = np.random.default_rng(2)
    found = rows(*random.integers(0, 20, n).tolist())
    found["base_to_object"][:, 3:] = MIDDLES[random.integers(0, 60, n)]
    said = diversity(archive(found))
    assert len(np.unique(found["descriptor"][:, 0])) <= said.niches <= n
