"""Laws of the spherical prior."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.genomes import draw

from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.object_geometry import ObjectSurface

GENOMES = draw(500, 6)


@pytest.fixture(scope="module")
def decoder(cube):
    return Decoder(cube, "spherical", ObjectSurface(cube))


def test_the_hand_stands_at_its_radius_longitude_and_colatitude(decoder):
    x, y, z = decoder(GENOMES).positions.astype(np.float64).T
    radius, longitude, colatitude = decoder.layout.values(GENOMES).T[:3]
    np.testing.assert_allclose(np.sqrt(x * x + y * y + z * z), radius, atol=1e-7)
    far = radius > 0.01
    np.testing.assert_allclose(np.arctan2(np.hypot(x, y), z)[far], colatitude[far], atol=1e-5)
    round_about = np.exp(1j * np.arctan2(y, x)) - np.exp(1j * longitude)
    np.testing.assert_allclose(np.abs(round_about)[far & (np.hypot(x, y) > 0.01)], 0, atol=1e-5)


def test_the_hand_is_turned_about_the_fixed_axes_x_y_and_z(decoder):
    angles = decoder.layout.values(GENOMES)[:, 3:]
    expected = Rotation.from_euler("xyz", angles)
    found = Rotation.from_quat(decoder(GENOMES).quaternions)
    np.testing.assert_allclose((expected.inv() * found).magnitude(), 0, atol=2e-6)
