"""The curve of a run: how its counts grew, in points few enough to be shown at once."""

from msgspec import Struct

POINTS = 512
"""The most points of a curve."""


class Point(Struct, frozen=True, array_like=True):
    """The counts of a run at the end of one of its generations; a list of five numbers in JSON."""

    evaluations: int
    proposals: int
    successes: int
    cells: int
    robust: int


class Curve(Struct, frozen=True, kw_only=True):
    """How the counts of a run grew. JSON, the answer to a query on `stat/curve/<run>`."""

    run: str
    points: list[Point]
    """At most `POINTS`, at evenly spaced generations."""
