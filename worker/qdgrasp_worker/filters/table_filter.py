"""Table filter: refuses hands that come below the table that the object rests on.

The table is a plane, and no body in the simulator: poses refused here are never simulated. A hand stays
above it if the lowest corner of its open fingers and palm does, at its pose and where its approach begins.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.grippers.reachability import HandApproach
from qdgrasp_assets.scene import Scene
from qdgrasp_worker.decoder import DecodedGrasps


class TableFilter:
    """Finds poses at which the hand comes below the table in each of a scene's resting poses."""

    def __init__(self, scene: Scene) -> None:
        self._poses = scene.resting_poses
        self._approach = HandApproach(scene.gripper, scene.approach_distance) if self._poses else None

    def __call__(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps that are refused; none without a table."""
        if self._approach is None:
            return places[:0]
        clear = self._approach.clear_of(
            self._poses, grasps.positions[places], grasps.quaternions[places], grasps.joints[places]
        )
        return places[~clear.any(axis=1)]
