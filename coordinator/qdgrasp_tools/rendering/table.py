"""A table under the object, which cuts hands off."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.niches import GenomeReader
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import parse_numbers

ROWS_AT_ONCE = 2048  # Hands that are placed at once
AS_MODELLED = Rotation.identity()  # The object stands as its mesh does, z up


@dataclass(frozen=True)
class TablePlane:
    """A plane that an object stands on, in the object's centre-of-mass frame."""

    up: Floats
    """(3,), unit: away from the table, at right angles to it."""
    height: float
    """Component of the plane's points along `up` [m]."""

    def is_clear_of(self, scene: Scene, prior: str, rows: Rows) -> NDArray[np.bool_]:
        """Flag the hands whose collision shapes are all above the table: (n,).

        `rows` are nominal rows of the scene whose hands have closed, `prior` that of their genomes. A hand is
        looked at in its commanded pose, both in the open posture and with the joints at the grasp.
        """
        hand = hand_geometry(scene.gripper)
        clear = np.zeros(len(rows), dtype=bool)
        for first in range(0, len(rows), ROWS_AT_ONCE):
            part = rows[first : first + ROWS_AT_ONCE]
            poses = part["base_to_object"].astype(np.float64)
            lows = [
                hand.lowest_points(poses, joints.astype(np.float64), self.up)
                for joints in (GenomeReader.of(scene, prior).postures(part), part["joints"])
            ]
            clear[first : first + ROWS_AT_ONCE] = np.min(lows, axis=0) >= self.height
        return clear


def table_under(scene: Scene, object_to_world: Rotation = AS_MODELLED) -> TablePlane:
    """Return the table that an object stands on in this orientation; z of the world is up."""
    up = object_to_world.inv().apply([0.0, 0.0, 1.0])
    vertices = scene.object.vertices.astype(np.float64)
    return TablePlane(up, float((vertices @ up).min()))


def orientation(words: str) -> Rotation:
    """Read a quaternion "x,y,z,w", or angles "x,y,z" about the fixed axes in turn [deg].

    Raises `ImpossibleValue` for other words.
    """
    found = parse_numbers(words)
    if len(found) == 3 and np.isfinite(found).all():
        return Rotation.from_euler("xyz", found, degrees=True)
    if len(found) == 4 and np.isfinite(found).all() and np.linalg.norm(found) > 1e-6:
        return Rotation.from_quat(found)
    expected = "a quaternion x,y,z,w or angles x,y,z in degrees, such as 90,0,0"
    raise ImpossibleValue("--object-pose", words, expected)
