"""The sweep: the space that a closing hand passes through, and whether an object has left it for good."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from qdgrasp_worker.bullet import Box, Vector
from qdgrasp_worker.grasp import Pose

MARGIN = 0.02
"""What contacts may bend the hand, and how far Bullet sees them ahead, together [m]."""


@dataclass(frozen=True)
class Sweep:
    """A box around everything that an object's centre must be near to be touched, hand frame [m]."""

    low: Vector
    high: Vector

    @classmethod
    def around(cls, boxes: list[Box], origin: Sequence[float], radius: float) -> Self:
        """The sweep of a hand at `origin` in `boxes`, for an object of `radius` about its CoM [m]."""
        aside = radius + MARGIN
        spans = [
            (min(low[i] for low, _ in boxes) - aside, max(high[i] for _, high in boxes) + aside)
            for i in range(3)
        ]
        low, high = zip(
            *[(low - o, high - o) for (low, high), o in zip(spans, origin, strict=True)], strict=True
        )
        return cls(low, high)

    def is_left(self, pose: Pose, position: Vector, velocity: Vector) -> bool:
        """Whether an object at `position` with `velocity` is outside for good, for a hand at `pose`.

        Nothing pulls a free object back: beyond a face of the box, and not on its way through it, the
        hand touches it no more.
        """
        offset = [a - b for a, b in zip(position, pose.position, strict=True)]
        for axis, low, high in zip(axes(pose.quaternion), self.low, self.high, strict=True):
            place, speed = dot(axis, offset), dot(axis, velocity)
            if (place > high and speed >= 0.0) or (place < low and speed <= 0.0):
                return True
        return False


def axes(quaternion: list[float]) -> tuple[Vector, Vector, Vector]:
    """The axes of a frame that is turned by a unit quaternion."""
    x, y, z, w = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def dot(a: Vector, b: Vector | list[float]) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
