"""The search that fills cells with grasps of several kinds, on a make-believe object."""

import numpy as np
import pytest
from tests.coordinator.search.synthetic_scene import Poses, evaluate, play, shape, space
from tests.coordinator.search.test_aimed import POSTURE, build, spec, targets

from qdgrasp_assets.geometry.rotation import unit
from qdgrasp_coordinator.metrics.cells import BINS, MIDDLES, cell_keys, cells, orientations
from qdgrasp_coordinator.search.niche_search import (
    KindReader,
)
from qdgrasp_coordinator.search.value_search import LOOSENESS, posture_genes
from qdgrasp_protocol.rows import Outcome, Rows

KINDS = {"aim_for": "hold", "diversity": "orientation"}


def kinds_per_cell(rows: Rows) -> list[int]:
    """The number of orientations that hold, in each cell with one."""
    held = rows[rows["outcome"] == Outcome.HELD]
    places = cell_keys(cells(held["descriptor"][:, :3]))
    pairs = np.unique(np.stack([places, orientations(held["base_to_object"][:, 3:])], axis=1), axis=0)
    return np.unique(pairs[:, 0], return_counts=True)[1].tolist()


def test_cells_hold_more_kinds_for_as_many_evaluations() -> None:
    one, many = (kinds_per_cell(play(*build(spec(**asked)), 600)) for asked in ({"aim_for": "hold"}, KINDS))
    assert np.mean(one) < 1.1
    assert np.mean(many) > 1.8
    assert sum(many) > 0.9 * sum(one)


@pytest.mark.parametrize("most", [2, 3])
def test_a_cell_is_filled_by_so_many_kinds_and_then_left_alone(most: int) -> None:
    seeking, where = build(spec(**KINDS, grasps_per_cell=most))
    held: dict[tuple[int, ...], set[int]] = {}
    again = 0
    for generation in range(20):
        rows = evaluate(where, generation, seeking.ask(generation))
        tight = rows[where.layout.values(rows["genome"])[:, LOOSENESS] == 0]
        aims = list(map(tuple, cells(targets(where, tight))))
        assert len(set(aims)) == len(aims)
        assert all(len(held.get(aim, ())) < most for aim in aims)
        again += sum(aim in held for aim in aims)
        seeking.tell(generation, rows)
        good = rows[rows["outcome"] == Outcome.HELD]
        for cell, kind in zip(
            map(tuple, cells(good["descriptor"][:, :3])),
            orientations(good["base_to_object"][:, 3:]).tolist(),
            strict=True,
        ):
            held.setdefault(cell, set()).add(kind)
    assert again > 50


def test_with_postures_a_synergy_makes_another_kind() -> None:
    where = space("valued", POSTURE)
    rows = shape(where).empty(3)
    rows["base_to_object"][:, 3:] = MIDDLES[[4, 4, 5]]
    rows["genome"][:, where.layout.names.index("synergy")] = [-1.0, 1.0, 1.0]
    synergy = KindReader(spec(diversity="posture"), where).of_rows(rows)
    assert synergy.tolist() == [4 + BINS, 4 + 2 * BINS, 5 + 2 * BINS]
    assert KindReader(spec(diversity="orientation"), where).of_rows(rows).tolist() == [4, 4, 5]


def test_the_kind_of_a_proposed_grasp_is_that_of_its_pose() -> None:
    random, where, n = np.random.default_rng(0), space("valued", POSTURE), 500
    ways, rolls = unit(random.standard_normal((n, 3))), random.uniform(0, 2 * np.pi, n)
    rows = shape(where).empty(n)
    rows["base_to_object"][:, 3:] = Poses(-0.1 * ways, np.zeros((n, 3)), ways, rolls).quaternions
    postures = random.uniform(-1, 1, (n, posture_genes(where)))
    rows["genome"][:, -postures.shape[1] :] = postures
    reader = KindReader(spec(diversity="posture"), where)
    proposed, clearness = reader.of_aims(ways, rolls, postures)
    is_clear = clearness > 1e-5  # rows are float32
    assert is_clear.mean() > 0.99
    assert proposed[is_clear].tolist() == reader.of_rows(rows)[is_clear].tolist()
    assert len(set(proposed.tolist())) > BINS
