import numpy as np
import trimesh

from qdgrasp_assets.mesh import Mesh, join
from qdgrasp_coordinator.analysis.light import SUN, lit, sky
from qdgrasp_coordinator.analysis.rays import Camera, Hits, Solid, camera, unit


def plate(height: float) -> Mesh:
    slab = trimesh.creation.box((0.1, 0.1, 0.002))
    return Mesh(np.array(slab.vertices), np.array(slab.faces)).moved((0.0, 0.0, height))


VIEW = camera(plate(0.0).vertices, 0.0, 0.5, 60, 60)


def upward(solid: Solid, view: Camera) -> Hits:
    return Hits(
        np.array([0]), np.zeros(1, np.float32), np.array([[0, 0, 0.001]], np.float32),
        np.array([[0, 0, 1]], np.float32), np.array([0]),
    )  # fmt: skip


def test_a_surface_that_faces_the_sun_with_nothing_above_it_receives_one() -> None:
    lamps, brightness = sky(VIEW)
    sun = unit(np.array([SUN]))[0] @ VIEW.axes
    assert np.isclose((brightness * np.clip(lamps @ sun, 0, None)).sum(), 1.0, atol=1e-4)
    assert (brightness > 0).all()


def test_a_plate_above_takes_most_of_the_light() -> None:
    open_sky = lit(upward(Solid(plate(0.0)), VIEW), Solid(plate(0.0)), VIEW)[0]
    covered = Solid(join([plate(0.0), plate(0.02)]))
    assert 0 <= lit(upward(covered, VIEW), covered, VIEW)[0] < 0.4 * open_sky
