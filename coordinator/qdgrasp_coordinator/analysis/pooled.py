"""Pooled runs: what a method reached with one hand on all of its objects, on average."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.analysis.entries import Entry, SceneName
from qdgrasp_coordinator.analysis.history import History

LEAST = 2
"""Objects, for a mean over objects."""


@dataclass(frozen=True)
class Pooled(History):
    """Runs with one seed on several objects; only coverage and evaluations are theirs together."""

    parts: tuple[History, ...] = ()

    def coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Mean over the objects after as many evaluations on each."""
        return np.asarray(np.mean([part.coverage(evaluations) for part in self.parts], axis=0))

    def published_coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """The same, as published."""
        return np.asarray(np.mean([part.published_coverage(evaluations) for part in self.parts], axis=0))


def pooled(entries: Sequence[Entry]) -> list[Entry]:
    """For each hand, its methods over those of its objects that have a set and that all of them were run on.

    Hands with less than two such objects are left out, and so are seeds that not every object has.
    """
    hands: dict[tuple[str, str], dict[tuple[str, str], dict[str, Entry]]] = {}
    for entry in entries:
        arms = hands.setdefault((entry.scene.gripper, entry.scene.protocol), {})
        arms.setdefault(entry.arm, {})
        if entry.target.size:
            arms[entry.arm][entry.scene.object] = entry
    return [entry for hand, arms in hands.items() for entry in _over_objects(*hand, arms)]


def _over_objects(hand: str, protocol: str, arms: dict[tuple[str, str], dict[str, Entry]]) -> list[Entry]:
    common = sorted(set.intersection(*(set(objects) for objects in arms.values())))
    if len(common) < LEAST:
        return []
    scene = SceneName(hand, f"{len(common)} objects", protocol)
    found = [(arm, _runs([objects[name] for name in common])) for arm, objects in arms.items()]
    return [Entry(scene, *arm, runs) for arm, runs in found if runs]


def _runs(entries: Sequence[Entry]) -> tuple[Pooled, ...]:
    """One pooled run for each seed that has begun on every object."""
    seeds = [{run.spec.seed: run for run in entry.runs if run.evaluations} for entry in entries]
    common = sorted(set.intersection(*(set(runs) for runs in seeds)))
    return tuple(_pooled(tuple(runs[seed] for runs in seeds)) for seed in common)


def _pooled(parts: tuple[History, ...]) -> Pooled:
    first = {field.name: getattr(parts[0], field.name) for field in fields(History)}
    target = replace(parts[0].target, stand_in=any(part.target.stand_in for part in parts))
    together = {
        "evaluations": min(part.evaluations for part in parts),
        "complete": all(part.complete for part in parts),
        "target": target,
    }
    return Pooled(**first | together, parts=parts)
