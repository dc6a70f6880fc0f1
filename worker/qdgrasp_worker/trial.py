"""Trials: a grasp that meets a disturbed object (mixture domain randomisation, Huber et al. 2024, appendix).

What a trial draws depends on the mixture, the grasp and the trial's number alone: a stored grasp that is
scored again meets the same trials, and no other grasp does. It is rounded for the reason that poses are
(`decode`).
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from qdgrasp_assets.rotation import Floats, conjugate, from_euler, multiply, rotate
from qdgrasp_worker.grasp import Pose

FRICTION_DECIMALS = 6
"""What frictions are rounded to: in decimals, so that the ends of an interval stay what the table says."""


@dataclass(frozen=True)
class Trial:
    """What is simulated of a grasp."""

    pose: Pose
    """In the CoM frame of the object as it lies in this trial."""
    frictions: tuple[float, float] | None = None
    """The object's coefficients of rolling and spinning friction; None: its own."""


@dataclass(frozen=True)
class Mixture:
    """What trials are drawn from, beginning with 1; trial 0 is the nominal one."""

    position_sigma: float
    """Of the object's displacement along each axis [m]."""
    angle_sigma: float
    """Of each of the angles by which the object turns about the fixed axes x, then y, then z [rad]."""
    rolling: tuple[float, float]
    """The interval of its coefficient of rolling friction."""
    spinning: tuple[float, float]
    """The interval of its coefficient of spinning friction."""
    seed: int = 0

    def trial(self, pose: Pose, number: int) -> Trial:
        """One of the trials of a grasp; the object turns about its centre of mass, after it is displaced."""
        random = np.random.default_rng([self.seed, *words(pose), number])
        position = random.normal(0.0, self.position_sigma, 3)
        quaternion = from_euler(random.normal(0.0, self.angle_sigma, (1, 3)))[0]
        frictions = coefficient(random, self.rolling), coefficient(random, self.spinning)
        return Trial(seen_from(position, quaternion, pose), frictions)


def words(pose: Pose) -> list[int]:
    """The sha256 of a grasp as it is simulated: pose and initial joints, float32, and synergy, int8."""
    numbers = np.array([*pose.position, *pose.quaternion, *pose.joints], dtype="<f4")
    digest = hashlib.sha256(numbers.tobytes() + np.int8(pose.synergy).tobytes()).digest()
    words: list[int] = np.frombuffer(digest, dtype="<u4").tolist()
    return words


def seen_from(position: Floats, quaternion: Floats, pose: Pose) -> Pose:
    """A pose in the frame of an object at `position` (3,) [m], turned by `quaternion` (4,).

    Only hand and object are in the world, so that it is the same to displace the one or the other. The
    object stays at the origin: there Bullet keeps it to the bit, whereas it rounds other rotations anew at
    every step.
    """
    back = conjugate(quaternion)
    offset = rotate(back, np.array(pose.position) - position)
    return replace(
        pose, position=rounded(offset), quaternion=rounded(multiply(back, np.array(pose.quaternion)))
    )


def rounded(values: Floats) -> list[float]:
    """Values as float32 has them."""
    single: list[float] = values.astype(np.float32).tolist()
    return single


def coefficient(random: Generator, interval: tuple[float, float]) -> float:
    """Draw a coefficient of friction."""
    return round(random.uniform(*interval), FRICTION_DECIMALS)
