"""The speed of something that is counted now and then, as it was lately."""

from math import exp, expm1

LATELY = 10.0
"""Seconds after which what was counted weighs 1 / e."""


class Speed:
    """How much is counted per second, lately. Time is passed in, in seconds of any steady clock."""

    def __init__(self, now: float) -> None:
        self._since = self._last = now
        self._weighed = 0.0

    def count(self, amount: float, now: float) -> None:
        """Count so much more."""
        self._weighed = self._weighed * exp((self._last - now) / LATELY) + amount
        self._last = now

    def at(self, now: float) -> float:
        """How much per second: a mean in which what is longer ago weighs less, over the time there was."""
        if now <= self._since:
            return 0.0
        return (
            self._weighed * exp((self._last - now) / LATELY) / (LATELY * -expm1((self._since - now) / LATELY))
        )
