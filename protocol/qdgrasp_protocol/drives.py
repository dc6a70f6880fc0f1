"""Drives of joints in `physical`: gains, for evaluations and exports (docs/protocols.md)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DriveGains:
    """Scale-free gains of the drives of one kind of joint.

    With the greatest force or torque `limit` of a drive kp = limit / lag, its reflected inertia is
    kp / frequency^2, and kd = 2 DAMPING_RATIO kp / frequency.
    """

    lag: float
    """Distance of a joint from its target at which its drive gives its limit [m or rad]."""
    frequency: float
    """Frequency of the drive's own motion, without friction [rad/s]."""
    effort: float
    """Force or torque of a drive whose own is not known, at most [N or N m]."""
    speed: float
    """Closing speed of drives for which none is known [m/s or rad/s]."""
    rest_speed: float
    """Speed below which a joint rests [m/s or rad/s]."""

    @classmethod
    def of(cls, kind: str) -> "DriveGains":
        """The gains of a kind of joint of URDF."""
        return SLIDING if kind == "prismatic" else TURNING


DAMPING_RATIO = 0.7
SLIDING = DriveGains(lag=0.014, frequency=220.0, effort=70.0, speed=0.1, rest_speed=2e-3)
"""With the effort of the Franka hand."""
TURNING = DriveGains(lag=0.23, frequency=55.0, effort=1.0, speed=1.0, rest_speed=0.02)
JAW_PRELOAD = 0.5  # Share of its greatest force with which each finger of a jaw grips: one drive moves both
