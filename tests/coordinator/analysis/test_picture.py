from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.picture import draw_grasps
from qdgrasp_coordinator.analysis.views import CUT_OPEN, best_in_cells, view_of_cells, view_of_hands
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import RunSpec

SMALL = 120


def rows_of(outcomes: list[Outcome], seed: int = 0) -> Rows:
    """Hands above and beside the block that look at it."""
    random = np.random.default_rng(seed)
    rows = Shape(7, 2).empty(len(outcomes))
    for row, outcome in zip(rows, outcomes, strict=True):
        away = random.normal(size=3)
        away *= 0.12 / np.linalg.norm(away)
        turned = Rotation.align_vectors([-away], [[0, 0, 1]])[0].as_quat()
        row["outcome"], row["fitness"] = outcome, max(0, outcome - Outcome.DROPPED)
        row["descriptor"], row["joints"] = away, 0.02
        row["base_to_object"] = np.concatenate([away, turned])
    return rows


def share_drawn(image: np.ndarray) -> float:
    return float((image[..., :3].min(axis=-1) < 0.99).mean())


@pytest.mark.parametrize("outcomes", [[], [Outcome.OVERLAP], [Outcome.HELD], [Outcome.DROPPED] * 3])
def test_a_run_is_drawn_however_little_it_found(make_scene, tmp_path: Path, outcomes: list[Outcome]) -> None:
    draw_grasps(make_scene(), rows_of(outcomes), tmp_path / "grasps.png", pixels=SMALL)
    image = matplotlib.image.imread(tmp_path / "grasps.png")
    assert share_drawn(image) > 0.02


def test_the_same_rows_give_the_same_picture(make_scene, tmp_path: Path) -> None:
    rows, spec = rows_of([Outcome.HELD] * 20), RunSpec(gripper="jaw", object="block")
    for name in ("a.png", "b.png"):
        draw_grasps(make_scene(), rows, tmp_path / name, spec=spec, pixels=SMALL)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_hands_are_drawn_over_the_object(make_scene) -> None:
    alone = view_of_hands(make_scene(), rows_of([]), 0.0, SMALL)
    held = view_of_hands(make_scene(), rows_of([Outcome.HELD] * 20), 0.0, SMALL)
    assert len(alone.shown) == 0
    assert 2 < len(held.shown) <= 20
    assert share_drawn(held.image) > 2 * share_drawn(alone.image)


def test_many_cells_are_cut_open_toward_the_viewer(make_scene) -> None:
    def shell(step: int) -> Rows:
        grid = np.stack(np.meshgrid(*[np.arange(-9, 10, step)] * 3), axis=-1).reshape(-1, 3)
        rows = Shape(7, 2).empty(len(grid))
        rows["descriptor"], rows["outcome"] = grid / 100, Outcome.HELD
        return rows

    scene: Scene = make_scene()
    assert len(shell(3)) < CUT_OPEN < len(shell(1))
    assert view_of_cells(scene, shell(3), 0.0, SMALL).whole
    assert not view_of_cells(scene, shell(1), 0.0, SMALL).whole


def test_a_cell_shows_its_fittest_success() -> None:
    rows = rows_of([Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN, Outcome.DROPPED])
    rows["descriptor"] = [[0.01, 0, 0], [0.012, 0, 0], [0.011, 0, 0], [0.05, 0, 0]]
    best = best_in_cells(rows)
    assert best["outcome"].tolist() == [Outcome.HELD, Outcome.DROPPED]
