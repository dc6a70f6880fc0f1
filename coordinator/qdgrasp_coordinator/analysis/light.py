"""Light: a sky of distant lamps, brighter over the viewer's left shoulder, and what it leaves in shadow."""

import numpy as np

from qdgrasp_coordinator.analysis.rays import LIFT, Camera, Floats, Hits, Solid, unit

LAMPS = 40
"""More make softer shadows; each costs a ray for every point that faces it."""
SUN = (-0.50, 0.72, 0.50)
"""The brightest direction: right, up, toward the eye."""


def sky(camera: Camera) -> tuple[Floats, Floats]:
    """Directions (n, 3) and brightness (n,) of the lamps, the points of a Fibonacci sphere.

    A surface that faces the sun, with nothing above it, receives 1.
    """
    place = np.arange(LAMPS) + 0.5
    height, turn = 1 - 2 * place / LAMPS, place * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    lamps = np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)
    sun = unit(np.array([SUN]))[0]
    brightness = 1.0 + 0.5 * height + 5.0 * np.exp(10.0 * (lamps @ sun - 1))
    brightness /= (brightness * np.clip(lamps @ sun, 0, None)).sum()
    return (lamps @ camera.axes).astype(np.float32), brightness.astype(np.float32)


def lit(hits: Hits, solid: Solid, camera: Camera) -> Floats:
    """The light that arrives at each hit (m,), shadows of `solid` included."""
    light = np.zeros(len(hits.pixels), dtype=np.float32)
    lifted = hits.points + LIFT * hits.normals
    for lamp, brightness in zip(*sky(camera), strict=True):
        slant = hits.normals @ lamp
        facing = np.flatnonzero(slant > 0)
        free = solid.open_toward(lifted[facing], lamp)
        light[facing] += brightness * slant[facing] * free
    return light


def soft_light(normals: Floats, camera: Camera) -> Floats:
    """The light on what is translucent, by its normals (m, 3): 1 facing the sun, 0 facing away."""
    sun = unit(np.array([SUN]))[0] @ camera.axes
    light: Floats = 0.5 + 0.5 * (normals @ sun)
    return light
