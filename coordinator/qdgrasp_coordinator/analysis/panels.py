"""Panels: the curves on one scene, and what is said of them above a panel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qdgrasp_coordinator.analysis.curves import COVERAGE, Curve, Measure, curve, measure_of
from qdgrasp_coordinator.analysis.entries import Entry, SceneName
from qdgrasp_coordinator.analysis.pooled import Pooled

LETTERS = 17
"""Of a panel's heading, in an inch."""


@dataclass(frozen=True)
class Panel:
    """The curves on one scene."""

    scene: SceneName
    measure: Measure
    curves: tuple[Curve, ...]

    @property
    def end(self) -> int:
        """Evaluations of the longest curve."""
        return max(int(one.evaluations[-1]) for one in self.curves)

    @property
    def top(self) -> float:
        """The greatest third quartile."""
        return max(float(np.nanmax(one.high, initial=0.0)) for one in self.curves)


def panels(entries: Sequence[Entry]) -> list[Panel]:
    """The curves of all entries, scene by scene."""
    scenes: dict[SceneName, list[Entry]] = {}
    for entry in entries:
        scenes.setdefault(entry.scene, []).append(entry)
    found = []
    for scene, here in scenes.items():
        measure = measure_of(here)
        found.append(Panel(scene, measure, tuple(curve(entry, measure) for entry in here)))
    return found


def measure_words(panel: Panel) -> str:
    """What is measured on a scene, and how far it can be compared."""
    target = panel.curves[0].entry.target
    if panel.measure is COVERAGE:
        pool = ", mean over objects" if isinstance(panel.curves[0].entry.runs[0], Pooled) else ""
        return f"{panel.measure.words}{pool}{', on a stand-in for the scan' if target.stand_in else ''}"
    return f"{panel.measure.words}: {target.why or 'not all runs have an S_G'}"


def run_words(entries: Sequence[Entry], room: float) -> str:
    """How many seeds of how many evaluations there are, in `room` inches: which methods have others."""
    kinds: dict[str, list[str]] = {}
    for entry in entries:
        kinds.setdefault(_runs([entry]), []).append(entry.name)
    usual, *others = sorted(kinds, key=lambda kind: -len(kinds[kind]))
    words = "; ".join([usual, *(f"{', '.join(kinds[kind])}: {_short(kind)}" for kind in others)])
    return words if len(words) <= LETTERS * room else _runs(entries)


def _short(kind: str) -> str:
    return kind.replace(" seeds", "").replace(" seed", "").replace(" evaluations", "")


def _runs(entries: Sequence[Entry]) -> str:
    seeds = _span([len(entry.runs) for entry in entries])
    ends = _span([run.evaluations for entry in entries for run in entry.runs])
    unfinished = sum(entry.unfinished for entry in entries)
    mark = f", {unfinished} unfinished" if unfinished else ""
    return f"{seeds} seed{'' if seeds == '1' else 's'} \u00d7 {ends} evaluations{mark}"


def _span(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"
