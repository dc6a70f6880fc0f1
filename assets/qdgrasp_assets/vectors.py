"""Vectors as values: three plain floats."""

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Vector


def vector(values: Floats) -> Vector:
    """Three numbers as plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
