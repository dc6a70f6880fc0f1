import numpy as np

from qdgrasp_coordinator.analysis.layers import FINE, Image
from qdgrasp_coordinator.analysis.rays import Camera, Hits

VIEW = Camera(np.eye(3, dtype=np.float32), np.zeros(2, np.float32), 0.01, FINE, FINE)
"""One pixel of the final image."""
RED, BLUE = np.array([[1.0, 0, 0]], np.float32), np.array([[0, 0, 1.0]], np.float32)


def everywhere(depth: float) -> Hits:
    points = FINE * FINE
    none = np.zeros((points, 3), np.float32)
    return Hits(np.arange(points), np.full(points, depth, np.float32), none, none, np.zeros(points, int))


def spread(colour: np.ndarray) -> np.ndarray:
    return np.repeat(colour, FINE * FINE, axis=0)


def half() -> np.ndarray:
    return np.full(FINE * FINE, 0.5, np.float32)


def test_an_empty_image_is_white() -> None:
    assert Image(VIEW).finished().tolist() == [[[1.0, 1.0, 1.0]]]


def test_the_nearer_of_two_solids_is_seen_whatever_the_order() -> None:
    for order in ((1.0, 2.0), (2.0, 1.0)):
        image = Image(VIEW)
        for depth in order:
            image.add_solid(everywhere(depth), spread(RED if depth == 1.0 else BLUE))
        assert image.finished()[0, 0].tolist() == [1.0, 0.0, 0.0]


def test_veils_lie_over_one_another_from_back_to_front_whatever_the_order() -> None:
    for order in ((1.0, 2.0), (2.0, 1.0)):
        image = Image(VIEW)
        for depth in order:
            image.add_veil(everywhere(depth), spread(RED if depth == 1.0 else BLUE), half())
        assert image.finished()[0, 0].tolist() == [0.75, 0.25, 0.5]


def test_a_veil_behind_a_solid_is_hidden() -> None:
    image = Image(VIEW)
    image.add_veil(everywhere(3.0), spread(BLUE), half())
    image.add_solid(everywhere(2.0), spread(RED))
    assert image.finished()[0, 0].tolist() == [1.0, 0.0, 0.0]
