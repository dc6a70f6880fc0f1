"""A camera that has everything in its picture."""

import numpy as np
import pytest

from qdgrasp_worker.replay.renderer import FILLED_SHARE, fit_camera

WIDTH, HEIGHT = 400, 300
CLOUD = np.random.default_rng(0).uniform((0.1, -0.2, -0.1), (0.4, 0.1, 0.2), (50, 3))
VIEWS = [(0, 0), (40, 25), (200, -30), (90, 80), (-15, 90)]


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_everything_is_in_the_picture_and_fills_it(view):
    pixels = fit_camera(CLOUD, *view, WIDTH / HEIGHT).camera(WIDTH, HEIGHT).pixels(CLOUD)
    shares = np.abs(pixels / (WIDTH, HEIGHT) - 0.5) * 2
    assert shares.max() == pytest.approx(FILLED_SHARE, abs=0.02)


@pytest.mark.parametrize("view", VIEWS[:4], ids=str)
def test_the_objects_z_points_up_in_the_picture(view):
    camera = fit_camera(CLOUD, *view, WIDTH / HEIGHT).camera(WIDTH, HEIGHT)
    (column, row), (above, higher) = camera.pixels(np.array([[0.2, 0, 0.1], [0.2, 0, 0.14]]))
    assert above == pytest.approx(column, abs=12)
    assert higher < row


def test_who_looks_along_minus_x_has_y_to_the_right():
    camera = fit_camera(CLOUD, 0.0, 0.0, WIDTH / HEIGHT).camera(WIDTH, HEIGHT)
    (left, _), (right, _) = camera.pixels(np.array([[0.2, 0.0, 0.1], [0.2, 0.05, 0.1]]))
    assert right > left


def test_what_is_nearer_is_larger():
    camera = fit_camera(CLOUD, 0.0, 0.0, WIDTH / HEIGHT).camera(WIDTH, HEIGHT)
    near, far = (np.ptp(camera.pixels(np.array([[x, -0.05, 0.1], [x, 0.05, 0.1]]))[:, 0]) for x in (0.4, 0.1))
    assert near > far
