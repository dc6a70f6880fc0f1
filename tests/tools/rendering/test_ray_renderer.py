import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import Mesh, join
from qdgrasp_tools.rendering.ray_renderer import (
    FAR,
    RAYS_PER_PIXEL,
    SUN,
    LayeredImage,
    ParallelCamera,
    RayHits,
    RayMesh,
    corner_normals,
    fit_camera,
    shadowed_light,
    sky_lamps,
    unit_vectors,
)


def ball(radius: float = 0.05) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh(np.array(sphere.vertices), np.array(sphere.faces))


def box(*sides: float) -> Mesh:
    """A box with these sides; of one a cube."""
    made = trimesh.creation.box(sides * 3 if len(sides) == 1 else sides)
    return Mesh(np.array(made.vertices), np.array(made.faces))


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (-0.9, 0.4), (2.5, -1.2)])
def test_a_ball_is_seen_where_and_as_far_as_it_is(azimuth: float, elevation: float) -> None:
    view = fit_camera(ball().vertices, azimuth, elevation, (100, 100))
    hits = RayMesh(ball()).cast_from(view)
    assert np.allclose(np.linalg.norm(hits.points, axis=1), 0.05, atol=3e-4)
    assert (hits.points @ view.axes[2] > -1e-3).all()
    assert np.allclose(FAR - hits.depth, hits.points @ view.axes[2], atol=1e-5)
    assert np.isclose(len(hits.pixels) * view.step**2, np.pi * 0.05**2, rtol=0.01)


def test_a_ball_is_smooth_and_a_box_keeps_its_edges() -> None:
    hits = RayMesh(ball()).cast_from(fit_camera(ball().vertices, 0.3, 0.2, (100, 100)))
    assert np.allclose(hits.normals, hits.points / 0.05, atol=0.02)
    faces = box(0.06)
    assert np.allclose(corner_normals(faces), faces.normals[:, None], atol=1e-6)


def test_what_stands_behind_is_not_seen() -> None:
    both = join([box(0.06), box(0.02).moved((-0.06, 0.0, 0.0))])
    assert RayMesh(both).cast_from(fit_camera(both.vertices, 0.0, 0.0, (50, 50))).faces.max() < 12


def test_a_point_of_the_image_looks_where_the_camera_projects() -> None:
    view = fit_camera(ball().vertices, 0.7, 0.3, (80, 60))
    pixels = np.array([0, 159, 160 * 60 + 80, 160 * 120 - 1])
    seen = view.project(view.origins(pixels))
    row, column = np.divmod(pixels, 160)
    assert np.allclose((seen[:, 0] - view.low[0]) / view.step, column + 0.5, atol=1e-3)
    assert np.allclose((seen[:, 1] - view.low[1]) / view.step, 120 - row - 0.5, atol=1e-3)


def test_a_window_holds_every_point_that_sees_the_mesh() -> None:
    small = box(0.02).moved((0.05, -0.03, 0.02))
    view = fit_camera(join([ball(), small]).vertices, -0.9, 0.4, (75, 75))
    everywhere = np.arange(150 * 150)
    rays = np.broadcast_to(-view.axes[2], (len(everywhere), 3)).copy()
    found = RayMesh(small).rays.run(view.origins(everywhere), rays)
    assert set(np.flatnonzero(found >= 0)) == set(RayMesh(small).cast_from(view).pixels)


def plate(height: float) -> Mesh:
    return box(0.1, 0.1, 0.002).moved((0.0, 0.0, height))


VIEW = fit_camera(plate(0.0).vertices, 0.0, 0.5, (30, 30))


def upward(solid: RayMesh, view: ParallelCamera) -> RayHits:
    return RayHits(
        np.array([0]), np.zeros(1, np.float32), np.array([[0, 0, 0.001]], np.float32),
        np.array([[0, 0, 1]], np.float32), np.array([0]), np.zeros((1, 3), int), np.ones((1, 3)),
    )  # fmt: skip


def test_a_surface_that_faces_the_sun_with_nothing_above_it_receives_one() -> None:
    lamps, brightness = sky_lamps(VIEW)
    sun = unit_vectors(np.array([SUN]))[0] @ VIEW.axes
    assert np.isclose((brightness * np.clip(lamps @ sun, 0, None)).sum(), 1.0, atol=1e-4)
    assert (brightness > 0).all()


def test_a_plate_above_takes_most_of_the_light() -> None:
    open_sky = shadowed_light(upward(RayMesh(plate(0.0)), VIEW), RayMesh(plate(0.0)), VIEW)[0]
    covered = RayMesh(join([plate(0.0), plate(0.02)]))
    assert 0 <= shadowed_light(upward(covered, VIEW), covered, VIEW)[0] < 0.4 * open_sky


FLAT_VIEW = ParallelCamera(
    np.eye(3, dtype=np.float32), np.zeros(2, np.float32), 0.01, RAYS_PER_PIXEL, RAYS_PER_PIXEL
)
"""One pixel of the final image."""
RED, BLUE = np.array([[1.0, 0, 0]], np.float32), np.array([[0, 0, 1.0]], np.float32)


def everywhere(depth: float) -> RayHits:
    points = RAYS_PER_PIXEL * RAYS_PER_PIXEL
    none = np.zeros((points, 3), np.float32)
    return RayHits(
        np.arange(points),
        np.full(points, depth, np.float32),
        none,
        none,
        np.zeros(points, int),
        none.astype(int),
        none,
    )


def spread(colour: np.ndarray) -> np.ndarray:
    return np.repeat(colour, RAYS_PER_PIXEL * RAYS_PER_PIXEL, axis=0)


def half() -> np.ndarray:
    return np.full(RAYS_PER_PIXEL * RAYS_PER_PIXEL, 0.5, np.float32)


@pytest.mark.parametrize("order", [(1.0, 2.0), (2.0, 1.0)])
def test_the_nearer_of_solids_is_seen_and_veils_lie_over_one_another_whatever_the_order(order) -> None:
    solid, veiled = LayeredImage(FLAT_VIEW), LayeredImage(FLAT_VIEW)
    for depth in order:
        colour = spread(RED if depth == 1.0 else BLUE)
        solid.add_solid(everywhere(depth), colour)
        veiled.add_translucent(everywhere(depth), colour, half())
    assert solid.composed()[0, 0].tolist() == [1.0, 0.0, 0.0]
    assert veiled.composed()[0, 0].tolist() == [0.75, 0.25, 0.5]
