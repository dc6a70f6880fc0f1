"""The search that aims at value, on a make-believe object; its cells, models and measures of quality."""

from dataclasses import replace

import numpy as np
import pytest
from tests.coordinator.metrics.test_grasp_quality import rows_of
from tests.coordinator.scenes import made_scene
from tests.coordinator.search.synthetic_scene import covered, evaluate, play, space
from tests.coordinator.search.test_aimed import build, spec, targets

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.grasp_quality import recorded_margins
from qdgrasp_coordinator.search.base import search_space
from qdgrasp_coordinator.search.value_search import (
    FULL_ETAS,
    FULL_MARGIN,
    LOOSENESS,
    QUALITY_GRAIN,
    ValueSearch,
    quality_measure,
)
from qdgrasp_protocol.rows import Outcome

SPACE = space("valued")


def test_to_aim_for_grasps_that_hold_finds_more_of_them_and_hardly_fewer_touches() -> None:
    hold, touch = (play(*build(spec(aim_for=aim_for)), 1200) for aim_for in ("hold", "touch"))
    assert covered(hold, Outcome.HELD) > 1.1 * covered(touch, Outcome.HELD)
    assert covered(hold) > 0.9 * covered(touch)


def test_a_cell_stays_open_until_it_holds() -> None:
    """In a box of few cells, weak ones are tried again as soon as the empty ones are spent."""
    where = replace(SPACE, box=(np.array([0.06, -0.03, -0.03]), np.array([0.11, 0.03, 0.03])))
    seeking = ValueSearch(spec(aim_for="hold"), where)
    held: set[tuple[int, ...]] = set()
    touched: set[tuple[int, ...]] = set()
    again = 0
    for generation in range(30):
        rows = evaluate(where, generation, seeking.ask(generation))
        tight = rows[where.layout.values(rows["genome"])[:, LOOSENESS] == 0]
        aims = set(map(tuple, cells(targets(where, tight))))
        assert len(aims) == len(tight)
        assert not aims & held
        again += len(aims & touched)
        seeking.tell(generation, rows)
        for found, least in ((held, Outcome.HELD), (touched, Outcome.DROPPED)):
            found |= set(map(tuple, cells(rows[rows["outcome"] >= least]["descriptor"][:, :3])))
    assert again > 20


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"aim_for": "hold"}, [1, 1, 0, 0]),
        ({"aim_for": "eta", "protocol": "robust"}, [1, 0.5, 0.05, 0]),
        ({"aim_for": "eta", "protocol": "robust", "base": "physical"}, [1, 0.5, 0.05, 0]),
    ],
)
def test_quality_is_whether_a_grasp_held_or_its_eta_as_a_share_of_the_greatest(values, expected) -> None:
    asked, rows = spec(**values), rows_of(4)
    full = FULL_ETAS.get(asked.nominal_protocol, 1.0) * asked.disturbances * 100  # trials
    rows["outcome"] = [Outcome.HELD, Outcome.HELD, Outcome.SHAKEN, Outcome.DROPPED]
    rows["fitness"] = [full * 2, full / 2, full / 20, 0]
    assert quality_measure(asked, SPACE)(rows) == pytest.approx(np.array(expected))


def test_a_margin_counts_as_a_share_of_the_greatest_in_whole_grains_and_none_as_nothing() -> None:
    scene, rows = made_scene("jaw"), rows_of(3)
    rows["contact_links"][1, 2:] = 0  # a single finger
    rows["settled"][2] = 0.0  # not recorded
    quality = quality_measure(spec(aim_for="margin"), search_space(scene, "valued"))(rows)
    share = min(1.0, recorded_margins(rows, scene.object)[0] / FULL_MARGIN)
    assert quality == pytest.approx([share, 0, 0], abs=1 / QUALITY_GRAIN)
    assert quality[0] > 0
    assert (quality * QUALITY_GRAIN % 1 == 0).all()
