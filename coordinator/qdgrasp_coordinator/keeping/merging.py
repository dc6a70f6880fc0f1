"""Merging: the successes of several runs of one scene in one folder, with what each came from.

Nothing depends on the order in which runs are named: they stand by method, seed and digest. A run that is
named twice, or is in two merged folders, is taken once, and so is a search that several of them record.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import msgspec

from qdgrasp_coordinator.analysis.diversity import diversity
from qdgrasp_coordinator.analysis.metrics import Metrics
from qdgrasp_coordinator.campaigns.summary import Summary
from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.niches import NicheArchive, synergies
from qdgrasp_coordinator.counts.tally import successes
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder, files
from qdgrasp_coordinator.folders.job_folder import RUN, Job
from qdgrasp_coordinator.folders.journal_format import FILE, Identity
from qdgrasp_coordinator.folders.names import LOGS
from qdgrasp_coordinator.keeping.parts import Part, parts_of
from qdgrasp_coordinator.keeping.reduction import rows_of, shape_of, write
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_protocol.trials import trials

SUMS = (
    "evaluations", "budget", "rows", "trials", "simulated", "proposals", "overlaps", "dead_ends",
    "successes", "grasps", "robust", "errors", "cpu_seconds", "wall_seconds",
)  # fmt: skip
"""Figures that are the sums of those of the sources; the others are counted anew."""
MOST_EVALUATIONS = 10**9


@dataclass(frozen=True)
class Merged:
    """What came of merging runs."""

    summary: Summary
    """What they found together."""
    repeats: tuple[str, ...]
    """Which of them were left out because another one has what they have, a sentence each."""


def merge(folders: Sequence[RunFolder], out: Path) -> Merged:
    """Join the successes of runs of one scene in a new folder, that appears whole or not at all.

    Raises
    ------
    FolderError, DiskFull
        A folder cannot be read, or `out` holds something or cannot be written.
    InputError
        The runs are of different scenes, or one under a protocol with trials is not finished.
    """
    RunFolder.check_free(out)
    parts, repeats = parts_of(folders)
    for part in parts:
        _check_same_scene(parts[0], part)
        _check_finished(part)
    shape, found = shape_of([part.folder for part in parts]), _found(parts)
    identity = Identity(RUN, to_toml(_spec(parts)), parts[0].source.scene, shape)
    disk.create(
        out,
        Job.begun(out, None).file | files(_spec(parts), parts[0].folder.bundle()),
        folders=[LOGS],
        fill=lambda made: write(
            made / FILE, identity, found, ((part.source, part.rows(shape)) for part in parts)
        ),
    )
    return Merged(found, tuple(one.words for one in repeats))


def _check_same_scene(one: Part, other: Part) -> None:
    if one.source.scene == other.source.scene:
        return
    specs = one.source.asked, other.source.asked
    keys = ("gripper", "object", "mass", "scale", "friction", "protocol", "surface_seed")
    differ = [f"{key} ({getattr(specs[0], key)} and {getattr(specs[1], key)})" for key in keys
              if getattr(specs[0], key) != getattr(specs[1], key)]  # fmt: skip
    why = ", ".join(differ) or "the scene's files or the version of qdgrasp that read them"
    raise InputError(
        f"{one.folder.path} and {other.folder.path} are of different scenes, which are not merged: they "
        f"differ in {why}."
    )


def _check_finished(part: Part) -> None:
    """Check that every success has its trials, where the protocol has them."""
    if trials(part.source.asked.protocol) and not part.source.summary["complete"]:
        raise InputError(
            f"{part.folder.path} is not finished, so that successes lack their trials: "
            f"`qdgrasp resume {part.folder.path}` goes on with it."
        )


def _spec(parts: Sequence[Part]) -> RunSpec:
    """What the merged folder says of itself: the first run's spec, with all evaluations."""
    budget = min(sum(part.source.asked.evaluations for part in parts), MOST_EVALUATIONS)
    first = parts[0].source.asked
    return msgspec.structs.replace(first, evaluations=budget, successes=None, no_new_cell=None, poses=None)


def _found(parts: Sequence[Part]) -> Summary:
    """What all runs found together."""
    first, told = parts[0].source, [part.source.summary for part in parts]
    values: dict[str, Any] = dict(first.summary)
    values |= {name: sum(one[name] for one in told) for name in SUMS}
    values |= {name: _listed(one[name] for one in told) for name in ("method", "overlaps_mode")}
    values |= {
        "complete": all(one["complete"] for one in told),
        "ended": f"merged from {counted(len(parts), 'run')}",
        "platform": reduce(_common, (part.source.platform for part in parts)),
        "reduced": "failures: only the successes of the merged runs are kept",
        "sources": [part.source.words for part in parts],
    }
    return msgspec.convert(values | _counted(parts, values), Summary)


def _counted(parts: Sequence[Part], sums: dict[str, Any]) -> dict[str, Any]:
    """The figures that depend on which cells and niches several runs share."""
    scene = parts[0].folder.scene()
    metrics, reached = Metrics(trials(parts[0].source.asked.protocol)), set[int]()
    archives = []
    for part in parts:
        archive = NicheArchive(synergies(scene, method(part.source.asked.method).prior))
        for rows in archive.inserting(rows_of(part.folder, part.number)):
            metrics.count(rows)
            reached.update(keys(cells(successes(rows)["descriptor"][:, :3])).tolist())
        archives.append(archive)
    done = sums["evaluations"]
    return {
        "cells": len(reached),
        "diversity": msgspec.to_builtins(diversity(reduce(NicheArchive.joined, archives))),
        "qd_score": metrics.qd_score,
        "success_share": sums["successes"] / done if done else None,
        "mean_fitness": metrics.mean_fitness,
        "nu": msgspec.to_builtins(metrics.nu),
        "eta": msgspec.to_builtins(metrics.eta),
    }


def _listed(names: Iterator[str]) -> str:
    return ", ".join(sorted(set(names)))


def _common(one: dict[str, str], other: dict[str, str]) -> dict[str, str]:
    """What two platforms have alike."""
    return {name: value for name, value in one.items() if other.get(name) == value}
