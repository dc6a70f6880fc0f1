"""Vectors as values: three plain floats."""

import numpy as np

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Vector


def vector(values: Floats) -> Vector:
    """Three numbers as plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def unit(axis: Vector) -> Vector:
    """A direction of length 1."""
    return vector(np.array(axis) / np.linalg.norm(axis))
