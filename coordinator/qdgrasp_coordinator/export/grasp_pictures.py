"""Pictures of grasps: hands as they settled, and the words that stand beside them."""

import numpy as np

from qdgrasp_coordinator.export.frames import COM
from qdgrasp_coordinator.export.grasp_set import Grasps
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS
from qdgrasp_coordinator.rendering.contact_sheet import PanelLabel, PlacedHands
from qdgrasp_protocol.rows import Outcome

FAILURE_COLOUR = "#d3d8dd"  # Of the dot of an evaluation that was no success


def placed_hands(grasps: Grasps, *, pregrasp: bool = False) -> PlacedHands:
    """Return the hands as they settled, or open in the commanded pose.

    A hand that never closed, since it overlapped the object, is open in any case.
    """
    is_open = pregrasp | (grasps.rows["outcome"] < Outcome.MISSED)[:, None]
    poses = np.where(is_open, grasps.poses(COM), grasps.settled_poses(COM))
    joints = np.where(is_open, grasps.pregrasp, grasps.joints).astype(np.float64)
    return PlacedHands(grasps.scene, grasps.rows, poses, joints)


def grasp_labels(grasps: Grasps) -> list[PanelLabel]:
    """Return the words below each grasp: number and outcome, then eta or fitness, and margin."""
    labels = []
    for place in range(len(grasps)):
        outcome, eta = Outcome(grasps.rows["outcome"][place]), grasps.eta[place]
        score = f"fitness {grasps.fitness[place]:g} of {grasps.spec.disturbances}"
        parts = [score if np.isnan(eta) else f"eta {eta:.2f}"]
        if not np.isnan(grasps.margin[place]):
            parts.append(f"margin {grasps.margin[place]:.2g}")
        colour = FITNESS_COLOURS[outcome - Outcome.DROPPED] if outcome.is_success else FAILURE_COLOUR
        title = f"{grasps.numbers[place]}  {outcome.name.lower().replace('_', ' ')}"
        labels.append(PanelLabel(title, ", ".join(parts), colour))
    return labels
