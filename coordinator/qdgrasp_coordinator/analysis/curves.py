"""Curves: a number over evaluations, as median and interquartile range over the runs of an entry."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.analysis.entries import Entry
from qdgrasp_coordinator.analysis.history import History

POINTS = 200
QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Measure:
    """A number of a run after some of its evaluations."""

    name: str
    words: str
    """What it is, and its unit, for an axis."""
    of: Callable[[History, ArrayLike], NDArray[np.float64]]


COVERAGE = Measure("coverage", "coverage of S_G", lambda run, at: run.coverage(at))
PUBLISHED = Measure("published", "coverage of S_G as published", lambda run, at: run.published_coverage(at))
CELLS = Measure("cells", "success cells of 1 cm", lambda run, at: run.cells.after(at).astype(np.float64))


def measure_of(entries: Iterable[Entry]) -> Measure:
    """How entries on one scene compare: by coverage, or by success cells where one lacks a set."""
    return COVERAGE if all(entry.target.size for entry in entries) else CELLS


@dataclass(frozen=True)
class Curve:
    """Quartiles over runs after so many counted evaluations: (k,) each."""

    entry: Entry
    measure: Measure
    evaluations: NDArray[np.int64]
    runs: NDArray[np.int64]
    """How many runs have got that far, which are those that the quartiles are of."""
    low: NDArray[np.float64]
    median: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def whole(self) -> int:
        """How many of its points all runs that have begun have reached."""
        return int(np.count_nonzero(self.runs == self.runs.max(initial=0)))


def curve(entry: Entry, measure: Measure, points: int = POINTS) -> Curve:
    """The curve of an entry at `points` equal steps and at as many equal factors, up to its longest run.

    A run counts as far as it goes, so that the median is of fewer runs beyond the end of the shortest.
    """
    begun = [run for run in entry.runs if run.evaluations]
    ends = np.array([run.evaluations for run in begun], dtype=np.int64)
    end = ends.max(initial=0)
    even, early = np.linspace(0, end, points + 1), np.geomspace(1, max(end, 1), points)
    at = np.unique(np.concatenate([np.concatenate([even, early]).round().astype(np.int64), ends]))
    values = np.array([np.where(at <= run.evaluations, measure.of(run, at), np.nan) for run in begun])
    if not begun:
        values = np.full((1, len(at)), np.nan)
    low, median, high = quartiles(values)
    return Curve(entry, measure, at, (at <= ends[:, None]).sum(axis=0), low, median, high)


def quartiles(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """First quartile, median and third quartile of each column of (n, k), NaN apart: (3, k)."""
    result = np.full((3, values.shape[1]), np.nan)
    some = ~np.isnan(values).all(axis=0)
    result[:, some] = np.nanquantile(values[:, some], QUARTILES, axis=0)
    return result


def value_after(run: History, measure: Measure, evaluations: int) -> float:
    """The number of one run after so many evaluations."""
    return float(measure.of(run, evaluations))
