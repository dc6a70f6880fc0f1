"""Filters of poses change no result."""

import pytest
from tests.worker.genomes import HANDS, draw, evaluated

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import Outcome

QUICK = {"panda": 200, "robotiq_2f": 300, "barrett": 40, "allegro": 40, "shadow": 40}


def different(scene, prior, genomes):
    """Number of rows that differ without shortcuts in more than their steps, and the rows."""
    rows, plain = (evaluated(scene, prior, genomes, batch=100, shortcuts=each) for each in (True, False))
    assert (rows["steps"] <= plain["steps"]).all()
    rows["steps"] = plain["steps"]
    return sum(ours.tobytes() != theirs.tobytes() for ours, theirs in zip(rows, plain, strict=True)), rows


def assert_same_without(scene, n, seed):
    """Rows of the prior contact are the same without shortcuts, and not all spared."""
    differing, rows = different(scene, "contact", draw(n, len(layout(scene, "contact")), seed))
    assert differing == 0
    assert (rows["outcome"] >= Outcome.MISSED).sum() > 10


@pytest.mark.parametrize(
    ("hand", "protocol", "engine"),
    [(hand, "paper", None) for hand in HANDS if hand != "barrett"]
    + [("panda", "paper", "mujoco"), ("barrett", "paper", "mujoco")]
    + [pytest.param("barrett", each, None, marks=pytest.mark.slow) for each in ("paper", "released")],
)
def test_a_built_in_hand_has_the_same_rows_without_them(hand, protocol, engine, make_scene):
    assert_same_without(make_scene(hand, "mug", protocol, engine), QUICK[hand], seed=4)
