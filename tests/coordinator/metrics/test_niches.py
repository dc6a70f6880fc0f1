import numpy as np
import pytest

from qdgrasp_coordinator.metrics.cells import MIDDLES
from qdgrasp_coordinator.metrics.niches import (
    GenomeReader,
    cell_of,
    niches,
    without_orientation,
    without_synergy,
)
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Gene, Layout, Outcome, Rows, RowShape

SHAPE = RowShape(genes=2, joints=1)
FOUR = GenomeReader(Layout("contact", (Gene("nu", 0.0, 1.0), Gene("synergy", 0.0, 3.0))))


def rows(n: int, outcome: Outcome = Outcome.HELD) -> Rows:
    made = SHAPE.empty(n)
    made["generation"], made["index"] = np.divmod(np.arange(n), 10)
    made["outcome"], made["fitness"] = outcome, max(0, outcome - Outcome.DROPPED)
    made["base_to_object"][:, 6] = 1
    return made


def test_cell_orientation_and_synergy_each_tell_niches_apart() -> None:
    found = rows(5)
    found["descriptor"][1, 2] = 0.01
    found["base_to_object"][2, 3:] = MIDDLES[7]
    found["genome"][3, 1] = 1.0
    found["genome"][4, 0] = 1.0  # another nu in the same niche
    keys = niches(found, FOUR)
    assert len(set(keys[:4])) == 4
    assert keys[4] == keys[0]
    assert (cell_of(keys)[[2, 3]] == cell_of(keys)[0]).all()
    assert cell_of(keys)[1] != cell_of(keys)[0]
    assert without_orientation(keys)[2] == without_orientation(keys)[0] != without_orientation(keys)[3]
    assert without_synergy(keys)[3] == without_synergy(keys)[0] != without_synergy(keys)[2]


@pytest.mark.parametrize(("gene", "label"), [(-1.0, 0), (-0.68, 0), (-0.66, 1), (0.2, 2), (1.0, 3)])
def test_the_synergy_is_read_from_the_genome_as_evaluation_reads_it(gene: float, label: int) -> None:
    assert FOUR.labels(np.array([[0.0, gene]], np.float32)).tolist() == [label]


def test_poses_that_are_given_hold_the_label_itself() -> None:
    given = GenomeReader(Layout(GIVEN, (Gene("x", -1.0, 1.0), Gene("synergy", 0.0, 3.0))))
    assert given.labels(np.array([[0.0, 2.0], [0.0, NO_SYNERGY]], np.float32)).tolist() == [2, NO_SYNERGY]
