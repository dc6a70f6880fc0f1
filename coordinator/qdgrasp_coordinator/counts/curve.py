"""The curve of a run: how its counts grew, in points few enough to be shown at once."""

from typing import Annotated, Protocol

from msgspec import Meta, Struct

POINTS = 512
"""The most points of a curve."""


class Counts(Protocol):
    """What a curve is of."""

    @property
    def evaluations(self) -> int:
        """Counted evaluations."""

    @property
    def proposals(self) -> int:
        """Poses that decoding screened."""

    @property
    def successes(self) -> int:
        """Nominal successes."""

    @property
    def cells(self) -> int:
        """Distinct 1 cm cells with one."""

    @property
    def robust(self) -> int:
        """Successes that survived both shakes."""


class Point(Struct, frozen=True, array_like=True):
    """The counts of a run at the end of one of its generations; a list of five numbers in JSON."""

    evaluations: Annotated[int, Meta(description="Counted evaluations.")]
    proposals: Annotated[int, Meta(description="Poses that decoding screened, simulated or not.")]
    successes: Annotated[int, Meta(description="A finger touches the object after closing.")]
    cells: Annotated[int, Meta(description="Distinct 1 cm cells with a success.")]
    robust: Annotated[int, Meta(description="Successes that survived both shakes: fitness 2.")]


class Curve(Struct, frozen=True, kw_only=True):
    """How the counts of a run grew. JSON, the answer to a query on `stat/curve/<run>`."""

    run: Annotated[str, Meta(description="Its name in its job.")]
    points: Annotated[
        list[Point],
        Meta(
            description="At most 512, at evenly spaced generations: "
            "evaluations, proposals, successes, cells, robust."
        ),
    ]


class Trail:
    """Notes the counts of a run generation by generation, and thins them by halves.

    A function of the rows alone: a run that was replayed has the same curve.
    """

    def __init__(self) -> None:
        self._points: list[Point] = []
        self._step = 1
        self._generations = 0

    def note(self, counts: Counts) -> None:
        """Note the counts at the end of the next generation."""
        self._generations += 1
        if self._generations % self._step:
            return
        if len(self._points) == POINTS:
            self._points = self._points[1::2]
            self._step *= 2
            if self._generations % self._step:
                return
        self._points.append(
            Point(counts.evaluations, counts.proposals, counts.successes, counts.cells, counts.robust)
        )

    def curve(self, run: str) -> Curve:
        """The curve so far of the run of that name."""
        return Curve(run=run, points=list(self._points))
