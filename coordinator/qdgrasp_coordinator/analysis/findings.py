"""Findings: numbers that speak for or against a claim, with their intervals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from qdgrasp_coordinator.analysis import bootstrap
from qdgrasp_coordinator.analysis.bootstrap import Interval, Values
from qdgrasp_coordinator.analysis.curves import measure_of, value_after
from qdgrasp_coordinator.analysis.entries import Entry, SceneName, usual
from qdgrasp_coordinator.analysis.history import History

FEW = 5
"""With fewer runs than this in an arm, a bootstrap interval is narrower than it should be."""
Scenes = dict[SceneName, dict[str, Entry]]
"""On each scene, the entry of each method."""


@dataclass(frozen=True)
class Finding:
    """One number."""

    subject: str
    """What is looked at, such as `contact_me_scs / contact_rand`."""
    statistic: str
    """What the number is."""
    interval: Interval
    evaluations: tuple[int, ...]
    """After how many counted evaluations, on each scene."""

    @property
    def is_of_few(self) -> bool:
        """Whether so few runs are behind it that its interval is too narrow."""
        return min(self.interval.runs, default=0) < FEW


def by_scene(entries: Sequence[Entry]) -> Scenes:
    """The entries that findings are made of: those with any row; of several variants, the most usual one."""
    return usual(entry for entry in entries if entry.settled)


def reached(scenes: Scenes, *methods: str) -> Finding | None:
    """The ratio of what two methods reached after as many evaluations; None: no scene has both."""
    upper, lower = list[Values](), list[Values]()
    after, measures = list[int](), list[str]()
    for pair in _having(scenes, methods):
        measure = measure_of(pair)
        measures.append(measure.name)
        after.append(min(run.evaluations for entry in pair for run in entry.settled))
        for arm, entry in zip((upper, lower), pair, strict=True):
            arm.append(np.array([value_after(run, measure, after[-1]) for run in entry.settled]))
    if not after:
        return None
    statistic = f"ratio of {' and of '.join(dict.fromkeys(measures))}"
    return Finding(" / ".join(methods), statistic, bootstrap.ratio(upper, lower), tuple(after))


def late(scenes: Scenes, method: str) -> Finding | None:
    """The share of what a method reached that the second half of its evaluations added."""
    chosen = [entry for (entry,) in _having(scenes, (method,))]
    if not chosen:
        return None
    interval = bootstrap.mean([_late_shares(entry) for entry in chosen])
    return Finding(method, "share added by the second half", interval, _ends(chosen))


def _late_shares(entry: Entry) -> Values:
    measure = measure_of([entry])
    ends = np.array([value_after(run, measure, run.evaluations) for run in entry.settled])
    halves = np.array([value_after(run, measure, run.evaluations // 2) for run in entry.settled])
    shares: Values = 1 - halves[ends > 0] / ends[ends > 0]
    return shares


def near(scenes: Scenes, method: str) -> Finding | None:
    """The share of a method's successes with nu below pi / 4."""
    chosen = [entry for (entry,) in _having(scenes, (method,))]
    if not chosen:
        return None
    return Finding(method, "share of successes with nu < pi/4", near_share(chosen), _ends(chosen))


def near_share(entries: Sequence[Entry]) -> Interval:
    """The share of successes with nu below pi / 4: mean over scenes of the mean over runs."""
    return bootstrap.mean([_near_shares(entry.settled) for entry in entries])


def _near_shares(runs: Sequence[History]) -> Values:
    return np.array([run.near_share for run in runs if run.near_share is not None], dtype=np.float64)


def _having(scenes: Scenes, methods: tuple[str, ...]) -> Iterator[tuple[Entry, ...]]:
    """The entries of these methods on each scene that has them all."""
    for entries in scenes.values():
        if all(method in entries for method in methods):
            yield tuple(entries[method] for method in methods)


def _ends(entries: Sequence[Entry]) -> tuple[int, ...]:
    return tuple(min(run.evaluations for run in entry.settled) for entry in entries)
