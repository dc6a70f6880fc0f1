"""Series: how figures grew while somebody watched, in points few enough to be drawn at once."""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from msgspec import Struct

from qdgrasp_coordinator.counts.figures import Figures, JobFigures

MOST = 600
"""The most points of a series."""
STEP = 1.0  # seconds between two points of a young one
WINDOW = 30.0  # seconds over which a rate is taken: results are told generation by generation

Kind = TypeVar("Kind")


class Series(Struct, frozen=True, kw_only=True):
    """How the figures of a job or a run grew, in columns of one length, at most `MOST`."""

    at: list[float]
    """When, in seconds since 1970."""
    evaluations: list[int]
    rate: list[float]
    """Counted evaluations per second over the half minute before, replayed ones apart."""
    successes: list[int]
    cells: list[int]
    robust: list[int]
    workers: list[int]


class Look(NamedTuple):
    """One look at the figures of a job or a run."""

    at: float
    seconds: float
    """Since its coordinator began with it."""
    fresh: float
    """Counted evaluations since then, replayed ones apart."""
    evaluations: int
    successes: int
    cells: int
    robust: int
    workers: int

    @classmethod
    def of(cls, figures: Figures | JobFigures, at: float) -> "Look":
        """What they were at a time."""
        one = figures
        fresh = one.rate * one.seconds
        return cls(at, one.seconds, fresh, one.evaluations, one.successes, one.cells, one.robust, one.workers)


class Thinned(Generic[Kind]):
    """Points in order of a place that only grows, thinned by halving; the first and the newest always stay.

    Parameters
    ----------
    place
        Where a point lies.
    most
        The most points.
    step
        How far apart they lie at least, at first.
    """

    def __init__(self, place: Callable[[Kind], float], most: int, step: float = 0.0) -> None:
        self._place = place
        self._most = most
        self._step = step
        self.points: list[Kind] = []

    def add(self, point: Kind) -> None:
        """Take the newest point; one that lies before the last is left out."""
        points, place = self.points, self._place
        if points and place(point) < place(points[-1]):
            return
        is_near = len(points) > 1 and place(point) - place(points[-2]) < self._step
        if is_near or (points and place(point) == place(points[-1])):
            points.pop()
        points.append(point)
        if len(points) > self._most:
            self._halve()

    def _halve(self) -> None:
        *kept, last = self.points
        self.points = [*kept[::2], last]
        self._step = 2 * (self._place(last) - self._place(kept[0])) / self._most


class History:
    """The looks at a job or a run, of which a series is made."""

    def __init__(self) -> None:
        self._looks: Thinned[Look] = Thinned(lambda look: look.at, MOST, STEP)

    def add(self, figures: Figures | JobFigures, at: float) -> None:
        """Note how far it is."""
        self._looks.add(Look.of(figures, at))

    @property
    def series(self) -> Series:
        """The series so far."""
        looks = self._looks.points
        return Series(
            at=[look.at for look in looks],
            evaluations=[look.evaluations for look in looks],
            rate=rates(looks),
            successes=[look.successes for look in looks],
            cells=[look.cells for look in looks],
            robust=[look.robust for look in looks],
            workers=[look.workers for look in looks],
        )


def rates(looks: list[Look]) -> list[float]:
    """Counted evaluations per second at each of some looks, over the `WINDOW` before it."""
    found, since = [], 0
    for number, look in enumerate(looks):
        if number and look.seconds < looks[number - 1].seconds:
            since = number  # another coordinator began to count anew
        while since < number - 1 and looks[since + 1].seconds <= look.seconds - WINDOW:
            since += 1
        found.append(_rate(looks[since], look))
    return found


def _rate(before: Look, after: Look) -> float:
    seconds, fresh = after.seconds - before.seconds, after.fresh - before.fresh
    if seconds <= 0:  # one look alone: since the coordinator began
        seconds, fresh = after.seconds, after.fresh
    return max(0.0, fresh / seconds) if seconds > 0 else 0.0
