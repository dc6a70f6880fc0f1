"""How an evaluation ended, from worst to best."""

from enum import IntEnum


class Outcome(IntEnum):
    """How an evaluation ended; a greater one got further.

    Stored as uint8 in messages and journal, so the numbers are part of the format.
    """

    ERROR = 0
    """The simulator failed on this row three times; the journal holds the reason."""
    DEAD_END = 1
    """Nothing to simulate: decoding found no pose, or none of several that is free and promises enough."""
    OVERLAP = 2
    """The open hand overlaps the object at the commanded pose."""
    MISSED = 3
    """No finger touched the object while the hand closed."""
    BRUSHED = 4
    """A finger touched the object while closing, but none does after it."""
    DROPPED = 5
    """A finger touches the object after closing; no shake was survived (fitness 0)."""
    SHAKEN = 6
    """One of the two shakes was survived (fitness 1)."""
    HELD = 7
    """Both shakes were survived (fitness 2): robust."""

    @property
    def is_simulated(self) -> bool:
        """The pose was free of overlap, so that the hand closed on it ("valid" in the paper's code)."""
        return self >= Outcome.MISSED

    @property
    def is_touched(self) -> bool:
        """A finger touched the object at some time while closing."""
        return self >= Outcome.BRUSHED

    @property
    def is_success(self) -> bool:
        """A finger touches the object after closing: what S_G and coverage count."""
        return self >= Outcome.DROPPED

    @property
    def is_grasp(self) -> bool:
        """At least one shake was survived: what users and exports call a grasp."""
        return self >= Outcome.SHAKEN

    @property
    def is_robust(self) -> bool:
        """Both shakes were survived."""
        return self >= Outcome.HELD
