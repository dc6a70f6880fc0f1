"""A film: which moments of an evaluation are shown, and for how long."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.replay import What
from qdgrasp_worker.replaying.moment import Moment

EVERY = 6
"""Steps, at 240 Hz, from one frame to the next,"""
FRAME = 0.08  # seconds
"""which is shown this long: what is filmed is 3.2 times slower than it was."""
REST = 0.96  # seconds for which the hand rests before it closes, when it has closed, and at the end
PARTS: dict[What, tuple[str, ...]] = {
    "all": ("placed", "closing", "shake z", "shake x"),
    "closing": ("placed", "closing"),
    "shakes": ("shake z", "shake x"),
}


class Take(NamedTuple):
    """A moment that is shown."""

    moment: Moment
    seconds: float


def still(moments: Sequence[Moment]) -> Moment:
    """The hand after closing; where it did not close, as it was placed."""
    return [moment for moment in moments if moment.phase in PARTS["closing"]][-1]


def film(moments: Sequence[Moment], what: What, outcome: Outcome) -> list[Take]:
    """What is shown of the moments of an evaluation, in their order.

    Raises
    ------
    InputError
        There is nothing of that part.
    """
    chosen = [moment for moment in moments if moment.phase in PARTS[what]]
    if not chosen:
        raise InputError(f"This evaluation has no {what} to show: its outcome is {outcome.name.lower()}.")
    return list(_takes(chosen))


def _takes(moments: Sequence[Moment]) -> Iterator[Take]:
    """Every so many steps one, and the last of each phase."""
    for moment, following in zip(moments, [*moments[1:], None], strict=True):
        is_last = following is None or following.phase != moment.phase
        rests = following is None or (is_last and moment.phase in PARTS["closing"])
        if is_last or moment.step % EVERY == 0:
            yield Take(moment, REST if rests else FRAME)
