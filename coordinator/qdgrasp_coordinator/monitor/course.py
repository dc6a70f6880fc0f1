"""The course of a run: its figures while it goes on, and how they came to be."""

from qdgrasp_coordinator.counts.curve import POINTS, Curve, Point
from qdgrasp_coordinator.counts.figures import Figures
from qdgrasp_coordinator.monitor.ratchet import raised
from qdgrasp_coordinator.monitor.series import History, Thinned


class Course:
    """A run as it was heard of; no count of it falls while it goes on."""

    def __init__(self, figures: Figures) -> None:
        self.figures = self._told = figures
        self.history = History()
        self.heard_at = 0.0
        self._points = _no_points()

    def heard(self, told: Figures, now: float, *, is_over: bool = False) -> None:
        """Hear how far it is; while it goes on, no count falls."""
        one = told if is_over or told.finished else raised(told, self.figures)
        self.figures, self._told, self.heard_at = one, told, now
        self.history.add(one, now)
        self._points.add(Point(one.evaluations, one.proposals, one.successes, one.cells, one.robust))

    def release(self) -> None:
        """Show it as it was told last: nobody goes on with it."""
        self.figures = self._told

    @property
    def rank(self) -> tuple[bool, float]:
        """The greater, the sooner it is to be remembered."""
        return not self.figures.finished, self.heard_at

    def answered(self, curve: Curve) -> None:
        """Hear how it got there; what was heard since is added."""
        later, self._points = self._points.points, _no_points()
        for point in [*curve.points, *later]:
            self._points.add(point)

    @property
    def curve(self) -> Curve:
        """How it grew."""
        return Curve(run=self.figures.run, points=list(self._points.points))


def _no_points() -> Thinned[Point]:
    return Thinned(lambda point: point.evaluations, POINTS)
