"""The lens: what a camera sees of the world, in OpenGL's matrices."""

from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.rotation import Floats
from qdgrasp_protocol.replay import Camera

FIELD = np.radians(28.0)
"""Of view, from the lower to the upper edge."""
FILLED = 0.94
"""How much of the picture is filled, to the farthest point."""
NEAR, FAR = 0.1, 10.0
"""What is drawn, as shares of the distance [-]."""


@dataclass(frozen=True)
class Lens:
    """A camera that looks at something, with the object's z upward."""

    azimuth: float
    """From the object's x towards its y [deg]."""
    elevation: float
    """Above the object's xy plane [deg]."""
    view: Floats
    """(4, 4): from the world to the camera, which looks along its -z."""
    projection: Floats
    """(4, 4): from the camera to clip coordinates."""

    def camera(self, width: int, height: int) -> Camera:
        """As whoever draws over its pictures is told of it."""
        matrix = self.projection @ self.view
        return Camera(
            azimuth=self.azimuth,
            elevation=self.elevation,
            matrix=tuple(matrix.ravel().tolist()),
            width=width,
            height=height,
        )


def lens(points: Floats, azimuth: float, elevation: float, aspect: float) -> Lens:
    """The nearest one that has all of `points` (n, 3) [m] in its picture.

    Parameters
    ----------
    aspect
        Of the picture: width over height.
    """
    axes = _axes(np.radians(azimuth), np.radians(elevation))
    right, up, back = (points @ axes.T).T
    slope = np.tan(FIELD / 2) * FILLED
    middle = [(side.min() + side.max()) / 2 for side in (right, up)]
    wide = np.abs(right - middle[0]) / (slope * aspect)
    high = np.abs(up - middle[1]) / slope
    away = float((back + np.maximum(wide, high)).max())
    distance = away - float(back.min())
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = axes, -np.array([*middle, away])
    return Lens(azimuth, elevation, view, _projection(aspect, NEAR * distance, FAR * distance))


def _axes(azimuth: float, elevation: float) -> Floats:
    """The camera's axes (3, 3), one in each row: to the right, upward, and back to where it stands."""
    back = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    return np.array([right, np.cross(back, right), back])


def _projection(aspect: float, near: float, far: float) -> Floats:
    """(4, 4): that of OpenGL's gluPerspective."""
    slope = np.tan(FIELD / 2)
    depth, shift = (far + near) / (near - far), 2 * far * near / (near - far)
    return np.array(
        [[1 / (slope * aspect), 0, 0, 0], [0, 1 / slope, 0, 0], [0, 0, depth, shift], [0, 0, -1, 0]]
    )
