import numpy as np
import pytest

from qdgrasp_coordinator.metrics.cells import MIDDLES
from qdgrasp_coordinator.metrics.niches import (
    NicheArchive,
    SynergyReader,
    cell_of,
    niches,
    without_orientation,
    without_synergy,
)
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Gene, Layout, Outcome, Rows, RowShape

SHAPE = RowShape(genes=2, joints=1)
FOUR = SynergyReader(Layout("contact", (Gene("nu", 0.0, 1.0), Gene("synergy", 0.0, 3.0))))


def rows(n: int, outcome: Outcome = Outcome.HELD) -> Rows:
    made = SHAPE.empty(n)
    made["generation"], made["index"] = np.divmod(np.arange(n), 10)
    made["outcome"], made["fitness"] = outcome, max(0, outcome - Outcome.DROPPED)
    made["base_to_object"][:, 6] = 1
    return made


def random_rows(n: int) -> Rows:
    random = np.random.default_rng(5)
    made = rows(n)
    made["outcome"] = random.integers(Outcome.OVERLAP, Outcome.HELD, n, endpoint=True)
    made["fitness"] = np.clip(made["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    made["descriptor"] = random.uniform(-0.02, 0.02, (n, 3))
    made["base_to_object"][:, 3:] = MIDDLES[random.integers(0, 3, n)]
    made["genome"] = random.uniform(-1, 1, (n, 2))
    made["penetration"], made["contacts"] = random.integers(0, 2, n) / 1000, random.integers(1, 3, n)
    return made


def archive(*blocks: Rows, synergies: SynergyReader = FOUR) -> NicheArchive:
    made = NicheArchive(synergies)
    for block in blocks:
        made.insert(block)
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
    given = SynergyReader(Layout(GIVEN, (Gene("x", -1.0, 1.0), Gene("synergy", 0.0, 3.0))))
    assert given.labels(np.array([[0.0, 2.0], [0.0, NO_SYNERGY]], np.float32)).tolist() == [2, NO_SYNERGY]


def test_only_nominal_successes_are_kept() -> None:
    found = rows(4, Outcome.DROPPED)
    found["descriptor"][:, 0] = np.arange(4) / 100
    found["outcome"][1] = Outcome.BRUSHED
    found["trial"][2] = 1
    assert archive(found).elites["index"].tolist() == [0, 3]


def test_the_best_of_a_niche_is_by_outcome_then_fitness_then_penetration_then_contacts_then_age() -> None:
    found = rows(6, Outcome.SHAKEN)
    found["outcome"][1] = Outcome.HELD
    for worse, field, value in ((2, "fitness", 0.5), (3, "penetration", 0.001), (4, "contacts", 1)):
        found["contacts"] = 2
        found[field][worse] = value
    found["contacts"][[0, 1, 2, 3, 5]], found["contacts"][4] = 2, 1
    order = [1, 0, 5, 4, 3, 2]
    for first, best in enumerate(order):
        left = np.isin(found["index"], order[first:])
        assert archive(found[left][::-1]).elites["index"].tolist() == [best]


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_blocks_of_any_length_and_order_give_one_archive(size: int) -> None:
    every = random_rows(1000)
    parts = [every[first : first + size] for first in range(0, len(every), size)]
    whole = archive(every).elites.tobytes()
    assert archive(*parts).elites.tobytes() == whole
    assert archive(*parts[::-1]).elites.tobytes() == whole
