"""The verdict on a guessed hand that closed on two objects, and flags that may correct it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.gripper_setup.closing_motion import ClosingMotion, approach_direction, axis_offset
from qdgrasp_assets.gripper_setup.posture_checks import AXIS_OFF, BESIDE
from qdgrasp_assets.grippers.gripper_file import GripperFile
from qdgrasp_protocol.rows import Outcome, Rows

SIZES = {"ball": (0.6, 0.06), "box": (0.45, 0.05)}
"""Size of each object as a share of the opening of the hand, and the largest [m]."""
SMALLEST = 0.01  # [m]
LEAST_HELD, LEAST_HELD_BY_TWO = 0.03, 0.3
"""Least share of the free poses in which a hand holds; two fingers oppose each other in most of them."""


def fitting_sizes(closing: ClosingMotion, file: GripperFile) -> dict[str, float]:
    """Return the size of each object for a hand, in whole millimetres [m]."""
    tips = closing.tips(0.0) if len(closing.fingers) > 1 else np.vstack([closing.tips(0), closing.tips(1)])
    one, other = np.triu_indices(len(tips), 1)
    opening = file.jaw.opening if file.jaw else float(np.linalg.norm(tips[one] - tips[other], axis=1).mean())
    return {
        name: round(min(max(share * opening, SMALLEST), most), 3) for name, (share, most) in SIZES.items()
    }


@dataclass(frozen=True)
class HandVerdict:
    """The evaluations of a guessed hand on both objects."""

    closing: ClosingMotion
    file: GripperFile
    links: Sequence[str]
    """The hand's links in the order in which rows count them."""
    rows: Rows
    """(n,): poses of which a right hand holds in a good share."""

    @property
    def touches(self) -> dict[str, int]:
        """Poses in which a finger touches the object after closing, by the link that begins it.

        The bars of a linkage, which move with two fingers that touch, are left out where they do not.
        """
        touched = self.rows["contact_links"][self.rows["outcome"] >= Outcome.DROPPED]
        places = [[self.links.index(link) + 1 for link in finger.links] for finger in self.closing.fingers]
        counts = [int(np.isin(touched, links).any(axis=1).sum()) for links in places]
        body, fingers = self.closing.body, list(zip(self.closing.fingers, counts, strict=True))
        touching = [name for finger, count in fingers if count for name in finger.joints]
        leaders = {body.leader(name) for name in touching} if np.count_nonzero(counts) > 1 else set()
        return {
            body.joint(finger.joints[0]).child: count
            for finger, count in fingers
            if count or not {body.leader(name) for name in finger.joints} <= leaders
        }

    @property
    def fault(self) -> str:
        """Its fault in words; empty for a hand that holds, and whose fingers all touch."""
        free, held = ((self.rows["outcome"] >= least).sum() for least in (Outcome.MISSED, Outcome.SHAKEN))
        least = LEAST_HELD_BY_TWO if len(self.touches) == 2 else LEAST_HELD
        if held < max(1.0, least * free):
            return f"it holds a ball and a box that fit it in {held} of {free} poses"
        idle = " and ".join(f"'{root}'" for root, count in self.touches.items() if not count)
        return f"the finger that begins with {idle} never touches what fits the hand" if idle else ""

    def flags(self) -> Iterator[str]:
        """Yield flags of `gripper new` that may correct the hand, the likeliest first."""
        touching = " ".join(f"--finger {root}" for root, count in self.touches.items() if count)
        if touching and not all(self.touches.values()):
            yield f"{touching}, if what never touches is no finger"
        axis, seen = np.array(self.file.approach_axis), approach_direction(self.closing)
        if seen @ axis < np.cos(AXIS_OFF):
            yield f"--approach-axis {' '.join(f'{value:g}' for value in seen)}, as the fingers close there"
        if (aside := axis_offset(self.closing, axis)) > BESIDE:
            yield f"--repair without --base-link, as the fingers close {1000 * aside:.0f} mm beside the line"
        name, closed = next(iter(self.closing.closed.items()))
        near, far = sorted(self.closing.body.range(name), key=lambda end: abs(end - closed))
        yield f"--open {name}={near:.4g} --closed {name}={far:.4g}, if it closes the other way"
        yield "--approach-axis X Y Z, if the arrow does not go from the palm to the object"
        yield f"--base-link {self.closing.body.joint(self.closing.fingers[0].joints[0]).parent}"
