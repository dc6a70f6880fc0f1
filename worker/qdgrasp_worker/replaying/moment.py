"""A moment of an evaluation: where everything was, and what touched."""

from dataclasses import dataclass

from qdgrasp_protocol.replay import Phase, Touch


@dataclass(frozen=True)
class Moment:
    """What there was before a step, or behind it."""

    phase: Phase
    step: int
    """Steps since the phase began."""
    root: tuple[list[float], list[float]]
    """Position [m] and quaternion xyzw of the carrier's root link, the object's CoM frame at first."""
    joints: list[float]
    """Positions of all joints that move [rad or m], in the order of `Witness.joints`."""
    object: tuple[list[float], list[float]]
    """Position [m] and quaternion xyzw of the object, of the same frame."""
    touches: tuple[Touch, ...]
    """The contacts of the last look at them."""
