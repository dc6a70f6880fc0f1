"""The figure of nu: how the successes of each method lean from the surface normal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from qdgrasp_coordinator.analysis.bootstrap import Interval
from qdgrasp_coordinator.analysis.entries import Entry
from qdgrasp_coordinator.analysis.findings import near_share
from qdgrasp_coordinator.analysis.history import NU_BINS
from qdgrasp_coordinator.analysis.palette import FAINT, FAMILIES, INK, family_of, hue_of, prior_of
from qdgrasp_coordinator.analysis.sheet import Sheet, heading, plain
from qdgrasp_protocol.phrases import counted

TICKS = (("0", 0.0), ("\u03c0/4", 0.25), ("\u03c0/2", 0.5), ("3\u03c0/4", 0.75), ("\u03c0", 1.0))
PANEL = (3.3, 1.3)
SHOWN = ("contact", "approach")
"""Priors whose palm looks at the surface; antipodal hands stand beside the line between their points."""
BOUNDED = {"approach": "at most \u03c0/4 by its prior"}
"""Priors that leave nu no choice."""


@dataclass(frozen=True)
class Lean:
    """The distribution of nu of a method's successes."""

    method: str
    variant: str
    share: NDArray[np.float64]
    """(24,): mean over scenes of the mean over runs of the share of successes in each bin."""
    near: Interval
    """The share below pi / 4."""
    scenes: int
    runs: int
    """With a success that has a nu."""
    evaluations: tuple[int, int]
    """Of the shortest and of the longest of these runs."""


def leans(entries: Sequence[Entry]) -> list[Lean]:
    """The distributions of all methods whose palm looks at the surface, over all scenes with a success."""
    methods: dict[str, list[Entry]] = {}
    for entry in entries:
        if prior_of(entry.method) in SHOWN and any(run.nu.any() for run in entry.settled):
            methods.setdefault(entry.name, []).append(entry)
    return [_lean(same) for same in methods.values()]


def _lean(entries: Sequence[Entry]) -> Lean:
    scenes = [[run for run in entry.settled if run.nu.any()] for entry in entries]
    share = np.mean([np.mean([run.nu / run.nu.sum() for run in runs], axis=0) for runs in scenes], axis=0)
    ends = [run.evaluations for runs in scenes for run in runs]
    near = near_share(entries)
    return Lean(*entries[0].arm, share, near, len(scenes), len(ends), (min(ends), max(ends)))


def draw_nu(found: Sequence[Lean]) -> Sheet:
    """A column for each prior, a row for each family of searches and each of its variants."""
    priors = [prior for prior in SHOWN if any(prior_of(lean.method) == prior for lean in found)]
    rows = sorted({_row(lean) for lean in found}, key=lambda row: (list(FAMILIES).index(row[0]), row[1]))
    sheet = Sheet(len(rows), len(priors), PANEL, over=0.7)
    for lean in found:
        row = _row(lean)
        top = max(float(one.share.max()) for one in found if _row(one) == row)
        _draw(sheet.axes(rows.index(row), priors.index(prior_of(lean.method))), lean, top)
    words = "Share of successes in bins of 7.5\u00b0; each scene and each run counts alike."
    sheet.title("Lean \u03bd of successes from the surface normal", words)
    return sheet


def _row(lean: Lean) -> tuple[str, str]:
    return family_of(lean.method), lean.variant


def _draw(axes: Axes, lean: Lean, top: float) -> None:
    plain(axes)
    edges, hue = np.linspace(0, 1, NU_BINS + 1), hue_of(lean.method)
    for low, high, opacity in ((0, NU_BINS // 4, 0.9), (NU_BINS // 4, NU_BINS, 0.4)):
        axes.stairs(lean.share[low:high], edges[low : high + 1], fill=True, color=hue, alpha=opacity)
    axes.axvline(0.25, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    if prior_of(lean.method) not in BOUNDED:
        axes.axhline(1 / NU_BINS, color=FAINT, linewidth=0.8, linestyle=(0, (1.5, 1.5)))
        axes.annotate(
            "uniform", (1, 1 / NU_BINS), (0, 3), textcoords="offset points", size=7, color=FAINT, ha="right"
        )
    axes.set(xlim=(0, 1), ylim=(0, 1.08 * top))
    axes.set_xticks([place for _, place in TICKS], [word for word, _ in TICKS])
    axes.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g}\u202f%")
    axes.yaxis.set_major_locator(MaxNLocator(3))
    heading(axes, lean.method, near_words(lean), behind_words(lean), color=hue)


def near_words(lean: Lean) -> str:
    """The share below pi / 4 with its interval."""
    bound = BOUNDED.get(prior_of(lean.method))
    if bound:
        return bound
    found = lean.near
    span = f" ({found.low:.0%} to {found.high:.0%})" if found.is_known else " (no interval from one run)"
    return f"{found.value:.0%} below \u03c0/4{span}"


def behind_words(lean: Lean) -> str:
    """What is behind a distribution."""
    low, high = lean.evaluations
    ends = f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"
    scenes = counted(lean.scenes, "scene")
    variant = f"{lean.variant}: " if lean.variant else ""
    return f"{variant}{counted(lean.runs, 'run')} \u00d7 {ends} evaluations, {scenes}"
