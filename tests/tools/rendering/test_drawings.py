from dataclasses import replace
from pathlib import Path

import matplotlib.image
import msgspec
import numpy as np
import pytest
import trimesh
from docs.demo import draw_grasps
from scipy.spatial.transform import Rotation
from tests.coordinator.scenes import made_scene, restricted_scene

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.stand_ins import stand_in
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.rendering.drawings import draw_gripper, draw_object, project_point
from qdgrasp_tools.rendering.ray_renderer import fit_camera
from qdgrasp_tools.rendering.views import broad_azimuth, view_of_cells, view_of_hands

SMALL, SPEC = 120, RunSpec(gripper="jaw", object="block")


def rows_of(outcomes: list[Outcome], seed: int = 0) -> Rows:
    """Hands above and beside the block that look at it."""
    random = np.random.default_rng(seed)
    rows = RowShape(7, 2).empty(len(outcomes))
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


@pytest.mark.parametrize("outcomes", [[], [Outcome.DROPPED] * 3])
def test_a_run_is_drawn_however_little_it_found(tmp_path: Path, outcomes: list[Outcome]) -> None:
    draw_grasps(made_scene(), rows_of(outcomes), tmp_path / "grasps.png", SPEC, pixels=SMALL)
    assert share_drawn(matplotlib.image.imread(tmp_path / "grasps.png")) > 0.02


def test_hands_are_drawn_over_the_object() -> None:
    alone = view_of_hands(made_scene(), rows_of([]), 0.0, SMALL)
    held = view_of_hands(made_scene(), rows_of([Outcome.HELD] * 20), 0.0, SMALL)
    assert share_drawn(held.image) > 2 * share_drawn(alone.image)


def test_hands_are_drawn_in_their_settled_poses() -> None:
    plain, rows = rows_of([Outcome.HELD] * 3), RowShape(7, 2, contact_slots=1).empty(3)
    for name in ("outcome", "fitness", "descriptor", "joints"):
        rows[name] = plain[name]
    rows["settled"] = plain["base_to_object"]
    rows["base_to_object"][:, 6] = 1  # all inside the object
    settled, commanded = (view_of_hands(made_scene(), found, 0.0, SMALL).image for found in (rows, plain))
    assert np.array_equal(settled, commanded)


def test_an_object_is_tinted_where_it_may_be_touched_and_seen_through_what_is_around_it() -> None:
    plain, image = (
        view_of_hands(scene, rows_of([]), 0.0, SMALL).image for scene in (made_scene(), restricted_scene())
    )
    tint = image[..., 1] - image[..., 0]  # green is what may be touched, the rest is reddish, neighbours grey
    may, may_not = (np.nonzero(one)[0] for one in (tint > 0.03, tint < -0.03))
    assert min(len(may), len(may_not)) > 100
    assert np.median(may) < np.median(may_not)  # rows count downward
    assert share_drawn(image) > 1.2 * share_drawn(plain)


def shell(step: int) -> Rows:
    """Successes in cells that are so many cm apart."""
    grid = np.stack(np.meshgrid(*[np.arange(-9, 10, step)] * 3), axis=-1).reshape(-1, 3)
    rows = RowShape(7, 2).empty(len(grid))
    rows["descriptor"], rows["outcome"] = grid / 100, Outcome.HELD
    return rows


def test_views_beside_each_other_have_one_camera_and_are_cut_open_alike() -> None:
    scene, few, many = made_scene(), shell(3)[100:300], shell(1)
    beside = [cells(rows["descriptor"]) for rows in (few, many)]
    one, other = (view_of_cells(scene, rows, 0.3, SMALL, beside=beside) for rows in (few, many))
    alone = view_of_cells(scene, few, 0.3, SMALL)
    assert np.array_equal(one.camera.low, other.camera.low)
    assert one.camera.step == other.camera.step > alone.camera.step
    assert not one.is_uncut
    assert alone.is_uncut


def halves(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The left and the right view of a portrait, without its words."""
    image = matplotlib.image.imread(path)[..., :3]
    rows, columns, _ = image.shape
    views = image[rows // 5 :]
    return views[:, : columns // 2], views[:, columns // 2 :]


@pytest.fixture
def _few_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qdgrasp_tools.rendering.drawings.PORTRAIT_PIXELS", 120)


@pytest.mark.usefixtures("_few_pixels")
def test_a_hand_is_drawn_open_and_closed(tmp_path: Path) -> None:
    draw_gripper(find_gripper("panda").on_carrier("paper"), tmp_path / "hand.png")
    opened, closed = halves(tmp_path / "hand.png")
    assert min(map(share_drawn, (opened, closed))) > 0.05
    assert not np.allclose(opened, closed)


@pytest.mark.filterwarnings("error")
@pytest.mark.usefixtures("_few_pixels")
def test_an_object_is_drawn_with_its_parts_in_colours_and_dollars_in_its_name_are_no_mathematics(
    tmp_path: Path,
) -> None:
    draw_object(replace(stand_in("mug"), name="$5$ $\\frac$"), tmp_path / "mug.png")
    surface, parts = halves(tmp_path / "mug.png")

    def colourful(view: np.ndarray) -> float:
        return float((np.ptp(view, axis=-1) > 0.4).mean())

    assert share_drawn(surface) == pytest.approx(share_drawn(parts), rel=0.05)
    assert colourful(parts) > 10 * colourful(surface)


def test_a_point_is_marked_where_the_camera_shows_it() -> None:
    corners = np.array([[-0.2, -0.2, 0.0], [0.2, 0.2, 0.0]])
    above = fit_camera(corners, -np.pi / 2, np.pi / 2, (100, 100))
    assert project_point(above, np.zeros(3)) == pytest.approx((50, 50), abs=0.1)
    right, low = project_point(above, np.array([0.1, -0.1, 0.0]))
    assert right > 60
    assert low > 60


def test_a_plate_is_seen_from_its_broad_side() -> None:
    plate, scene = trimesh.creation.box((0.02, 0.2, 0.1)), made_scene()
    mesh = {
        "mesh_vertices": plate.vertices.astype("<f4").tobytes(),
        "mesh_faces": plate.faces.astype("<u4").tobytes(),
    }
    seen = msgspec.structs.replace(scene, object=msgspec.structs.replace(scene.object, **mesh))
    assert abs(np.cos(broad_azimuth(seen))) > 0.9
