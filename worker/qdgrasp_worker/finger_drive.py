"""Drives of finger joints: PD laws whose torque is bounded by the real drive's limit."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from qdgrasp_assets.geometry.rotation import running_sum
from qdgrasp_assets.scene import Joint
from qdgrasp_worker.evaluation_protocols import DAMPING_RATIO, SLIDING, TURNING

SLIDING_EFFORT = 70.0  # Force of a sliding joint whose drive is not known, at most: Franka hand [N]
FINGERTIP_FORCE = 15.0  # Force at the fingertip of a turning joint whose drive is not known, at most [N]
JAW_PRELOAD = 0.5  # Share of its greatest force with which each finger of a jaw grips: one drive moves both


@dataclass(frozen=True)
class FingerDrive:
    """The drive of a finger joint; lengths in m, angles in rad, forces in N or Nm."""

    name: str
    opened: float
    closed: float
    lowest: float
    """Least target."""
    highest: float
    """Greatest target."""
    limit: float
    """Greatest force or torque."""
    stiffness: float
    damping: float
    inertia: float
    """Reflected inertia [kg or kg m2]."""
    lead: float
    """Greatest distance of the target from the joint."""
    speed: float
    """Closing speed [m/s or rad/s]."""
    rest_speed: float

    @classmethod
    def of(
        cls,
        joint: Joint,
        reach: float,
        *,
        slides: bool,
        limits: tuple[float, float],
        in_jaw: bool,
        haste: float,
    ) -> "FingerDrive":
        """The drive of a joint that reaches `reach` [m] to the farthest point that it moves.

        `limits` are the lower and upper limits of the URDF; reversed ones mean that there are none.
        """
        gains = SLIDING if slides else TURNING
        known = SLIDING_EFFORT if slides else FINGERTIP_FORCE * reach
        limit = joint.rated_effort or (min(joint.effort, known) if joint.effort > 0 else known)
        stiffness = limit / gains.lag
        # Bullet stops joints at limits in order, against any preload, and ignores reversed limits.
        lower, upper = sorted(limits)
        is_reversed = limits[0] > limits[1]
        return cls(
            name=joint.name,
            opened=joint.opened,
            closed=joint.closed if joint.driven else joint.opened,
            lowest=lower if is_reversed else -inf,
            highest=upper if is_reversed else inf,
            limit=limit,
            stiffness=stiffness,
            damping=2 * DAMPING_RATIO * stiffness / gains.frequency,
            inertia=stiffness / gains.frequency**2,
            lead=gains.lag * (JAW_PRELOAD if in_jaw else 1.0),
            speed=haste * (joint.rated_velocity or gains.speed),
            rest_speed=gains.rest_speed,
        )

    @property
    def duration(self) -> float:
        """Time in which it closes freely [s]."""
        return (abs(self.closed - self.opened) + self.lead) / self.speed


class TargetMotion(NamedTuple):
    """Direction and end of the motion of a joint's target."""

    sense: int
    """+1 or -1; 0: it stays."""
    end: float


class FingerControl:
    """The PD laws of a hand's finger joints, with their targets."""

    def __init__(self, drives: Sequence[FingerDrive], *, is_coupled: bool) -> None:
        self.drives = drives
        self.is_coupled = is_coupled
        self.targets = [drive.opened for drive in drives]
        """Target of each joint [m or rad]."""
        self._ways = [TargetMotion(0, drive.opened) for drive in drives]

    def start(self, posture: Sequence[float], closing: Sequence[str]) -> None:
        """Let the targets of the joints `closing` move from `posture`; the others stay there."""
        self.targets = list(posture)
        self._ways = [
            target_motion(drive, place) if drive.name in closing else TargetMotion(0, place)
            for drive, place in zip(self.drives, posture, strict=True)
        ]

    def stop(self) -> None:
        """Stop all targets."""
        self._ways = [TargetMotion(0, target) for target in self.targets]

    def torques(self, states: Sequence[tuple[float, float]], time_step: float) -> list[float]:
        """Advance the targets; return each joint's force or torque by its position and velocity."""
        targets = self.walk([position for position, _ in states], time_step)
        torques = []
        for drive, target, (position, velocity) in zip(self.drives, targets, states, strict=True):
            torque = drive.stiffness * (target - position) - drive.damping * velocity
            torques.append(max(-drive.limit, min(drive.limit, torque)))
        return torques

    def walk(self, positions: Sequence[float], seconds: float) -> list[float]:
        """Advance the targets by the joints' positions; return the target of each joint."""
        share = self._mean_share(positions) if self.is_coupled else None
        for i, (drive, way, position) in enumerate(zip(self.drives, self._ways, positions, strict=True)):
            sense, end = way
            if sense:
                place = position if share is None else drive.opened + share * (drive.closed - drive.opened)
                ahead = min(
                    sense * self.targets[i] + drive.speed * seconds,
                    sense * place + drive.lead,
                    sense * end,
                )
                self.targets[i] = sense * ahead
        return self.targets

    def _mean_share(self, positions: Sequence[float]) -> float:
        """Mean share of their way that the moving joints have gone."""
        shares = [
            (position - drive.opened) / (drive.closed - drive.opened)
            for drive, way, position in zip(self.drives, self._ways, positions, strict=True)
            if way.sense
        ]
        return running_sum(shares) / len(shares) if shares else 0.0

    def rests(self, before: Sequence[float], after: Sequence[float], seconds: float) -> bool:
        """Return whether no joint has moved faster than at rest from one look to the next."""
        return all(
            abs(now - then) < drive.rest_speed * seconds
            for drive, then, now in zip(self.drives, before, after, strict=True)
        )


def target_motion(drive: FingerDrive, place: float) -> TargetMotion:
    """The way of a joint from `place` beyond its closed position, within its limits."""
    sense = (drive.closed > place) - (drive.closed < place)
    return TargetMotion(sense, min(max(drive.closed + sense * drive.lead, drive.lowest), drive.highest))
