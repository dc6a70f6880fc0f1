import numpy as np
import pytest
import trimesh

from qdgrasp_assets.mesh import Mesh, join
from qdgrasp_coordinator.analysis.rays import FAR, Solid, camera, corner_normals


def ball(radius: float = 0.05) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh(np.array(sphere.vertices), np.array(sphere.faces))


def box(side: float = 0.06) -> Mesh:
    cube = trimesh.creation.box((side, side, side))
    return Mesh(np.array(cube.vertices), np.array(cube.faces))


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (-0.9, 0.4), (2.5, -1.2)])
def test_a_ball_is_seen_where_and_as_far_as_it_is(azimuth: float, elevation: float) -> None:
    view = camera(ball().vertices, azimuth, elevation, 200, 200)
    hits = Solid(ball()).seen_by(view)
    assert np.allclose(np.linalg.norm(hits.points, axis=1), 0.05, atol=3e-4)
    assert (hits.points @ view.axes[2] > -1e-3).all()
    assert np.allclose(FAR - hits.depth, hits.points @ view.axes[2], atol=1e-5)
    assert np.isclose(len(hits.pixels) * view.step**2, np.pi * 0.05**2, rtol=0.01)


def test_a_ball_is_smooth_and_a_box_keeps_its_edges() -> None:
    hits = Solid(ball()).seen_by(camera(ball().vertices, 0.3, 0.2, 200, 200))
    assert np.allclose(hits.normals, hits.points / 0.05, atol=0.02)
    faces = box()
    assert np.allclose(corner_normals(faces), faces.normals[:, None], atol=1e-6)


def test_what_stands_behind_is_not_seen() -> None:
    both = join([box(0.06), box(0.02).moved((-0.06, 0.0, 0.0))])
    hits = Solid(both).seen_by(camera(both.vertices, 0.0, 0.0, 100, 100))
    assert hits.faces.max() < 12


def test_a_point_of_the_image_looks_where_the_camera_projects() -> None:
    view = camera(ball().vertices, 0.7, 0.3, 120, 160)
    pixels = np.array([0, 159, 160 * 60 + 80, 160 * 120 - 1])
    seen = view.seen(view.origins(pixels))
    row, column = np.divmod(pixels, 160)
    assert np.allclose((seen[:, 0] - view.low[0]) / view.step, column + 0.5, atol=1e-3)
    assert np.allclose((seen[:, 1] - view.low[1]) / view.step, 120 - row - 0.5, atol=1e-3)


def test_a_window_holds_every_point_that_sees_the_mesh() -> None:
    small = box(0.02).moved((0.05, -0.03, 0.02))
    view = camera(join([ball(), small]).vertices, -0.9, 0.4, 150, 150)
    everywhere = np.arange(150 * 150)
    rays = np.broadcast_to(-view.axes[2], (len(everywhere), 3)).copy()
    found = Solid(small).rays.run(view.origins(everywhere), rays)
    assert set(np.flatnonzero(found >= 0)) == set(Solid(small).seen_by(view).pixels)


def test_a_lid_shuts_out_the_light_above_and_no_other() -> None:
    lid = Solid(box(0.06).moved((0.0, 0.0, 0.1)))
    below, beside = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]], dtype=np.float32)
    up = np.array([0.0, 0.0, 1.0], dtype=np.float32)
    assert lid.open_toward(np.stack([below, beside]), up).tolist() == [False, True]
    assert lid.open_toward(below[None], -up).tolist() == [True]
