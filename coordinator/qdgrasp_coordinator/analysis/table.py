"""A table under the object, and which hands would cut it.

The simulation has no table: a grasp from below is as good as one from above. On a table it is not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.hand import Floats, hand
from qdgrasp_coordinator.counts.poses import postures
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.phrases import numbers
from qdgrasp_protocol.rows import Rows

CHUNK = 2048
"""Hands that are placed at once."""
AS_MODELLED = Rotation.identity()
"""The object stands as its mesh does, z up."""


@dataclass(frozen=True)
class Table:
    """A plane that an object stands on, in the object's centre-of-mass frame."""

    up: Floats
    """(3,), unit: away from the table, at right angles to it."""
    height: float
    """Component of the plane's points along `up` [m]."""

    def is_clear_of(self, scene: Scene, prior: str, rows: Rows) -> NDArray[np.bool_]:
        """Which hands are above the table, with all of their collision shapes.

        Parameters
        ----------
        scene
            Of the rows.
        prior
            Of their genomes.
        rows
            Nominal rows whose hands have closed.

        Returns
        -------
        (n,): at the commanded pose, both with the open posture and with the joints at the grasp.
        """
        drawn = hand(scene.gripper)
        clear = np.zeros(len(rows), dtype=bool)
        for first in range(0, len(rows), CHUNK):
            part = rows[first : first + CHUNK]
            poses = part["base_to_object"].astype(np.float64)
            lows = [
                drawn.lowest(poses, joints.astype(np.float64), self.up)
                for joints in (postures(scene, prior, part), part["joints"])
            ]
            clear[first : first + CHUNK] = np.min(lows, axis=0) >= self.height
        return clear


def table_under(scene: Scene, object_to_world: Rotation = AS_MODELLED) -> Table:
    """The table that an object stands on when it is turned so; z of the world is up."""
    up = object_to_world.inv().apply([0.0, 0.0, 1.0])
    vertices = np.frombuffer(scene.object.mesh_vertices, "<f4").reshape(-1, 3).astype(np.float64)
    return Table(up, float((vertices @ up).min()))


def orientation(words: str) -> Rotation:
    """How an object is turned: a quaternion "x,y,z,w", or angles "x,y,z" about the fixed axes in turn [deg].

    Raises
    ------
    ImpossibleValue
        It is neither.
    """
    found = numbers(words)
    if len(found) == 3 and np.isfinite(found).all():
        return Rotation.from_euler("xyz", found, degrees=True)
    if len(found) == 4 and np.isfinite(found).all() and np.linalg.norm(found) > 1e-6:
        return Rotation.from_quat(found)
    expected = "a quaternion x,y,z,w or angles x,y,z in degrees, such as 90,0,0"
    raise ImpossibleValue("--object-pose", words, expected)
