"""The rows of finished runs, from their journals."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
from benchmarks.results.table import CPU_MILESTONES, MILESTONES, Key, Row, key, written
from scipy.optimize import nnls

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup, ReferenceSet
from qdgrasp_coordinator.metrics.run_stats import count_rows, evaluation_mask
from qdgrasp_coordinator.metrics.success_metrics import SuccessHistory, SuccessMetrics, diversity
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.engines import DEFAULT_ENGINE, EngineChoice, engine_names
from qdgrasp_protocol.rows import Outcome, Rows, trial_count
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.report.row_report import empty_niche_archive
from qdgrasp_tools.report.run_groups import search_run_folders
from qdgrasp_worker.engines import ENGINES
from qdgrasp_worker.platform import code_digest, worlds
from qdgrasp_worker.syntax_digest import syntax_digest

Figures = dict[str, str | int | float | None]
HEX = 16
"""Digits of a digest in the table."""
LEAST = 20
"""Blocks of a journal, and successes in them, from which costs are fitted."""

Budgets = Callable[[Key], set[int]]
"""The budgets with which rows are wanted of a run, whatever its own is."""


def finished_rows(path: Path, budgets: Budgets, targets: ReferenceLookup) -> Iterator[Row]:
    """The rows of the runs in a campaign's folder, in a folder of run folders, or in a run's own."""
    for folder in search_run_folders(path):
        asked = key(folder.spec)
        yield from rows_of(folder, asked, budgets(asked), targets)


def rows_of(folder: RunFolder, asked: Key, budgets: set[int], targets: ReferenceLookup) -> Iterator[Row]:
    """A row of a run for each of these budgets that it has spent.

    A longer run contains the shorter one, so that its journal gives the rows of both.
    """
    if not budgets:
        return
    with folder.journal() as journal:
        slices = list(journal.slices())
        rows = np.concatenate([journal.shape.empty(0), *(part.rows for part in slices)])
        stops = _stops(folder.spec, rows, budgets)
        known = _reference(folder, targets) if stops else None
        for budget, stop in stops.items():
            said = asked._replace(budget=budget)._asdict() | _origin(journal, rows[:stop], folder.spec)
            parts = [part.part(0, stop) for part in slices if part.first < stop]
            found = figures(folder, rows[:stop], known) | growth(folder.spec, parts) | costs(parts)
            found["wall_seconds"] = journal.wall_seconds if stop == len(rows) else None
            yield row(said | _with_ratio(found))


def _reference(folder: RunFolder, targets: ReferenceLookup) -> ReferenceSet | None:
    """The set of a run's object itself: a stand-in's coverage of its scan's set is no result."""
    target = targets.of(folder.scene(), folder.spec.object)
    return None if target.stand_in else target.reference


def row(values: Figures) -> Row:
    """A row of figures, as precise as the table is."""
    return msgspec.convert(rounded(values), Row)


def rounded(values: Figures) -> Figures:
    """Figures as precise as the table is."""
    return {name: float(written(one)) if isinstance(one, float) else one for name, one in values.items()}


def _stops(spec: RunSpec, rows: Rows, budgets: set[int]) -> dict[int, int]:
    """The number of a journal's rows that belong to each budget that is spent."""
    spent = np.cumsum(evaluation_mask(rows, spec.overlaps))
    least = 0 if trial_count(spec.protocol) or not len(rows) else min(spec.evaluations, int(spent[-1]) + 1)
    stops = {one: int(np.searchsorted(spent, one)) + 1 for one in sorted(budgets) if one < least}
    whole = spec.evaluations in budgets and count_rows(spec, [rows]).finished
    return stops | ({spec.evaluations: len(rows)} if whole else {})


def code_of(platform: Mapping[str, str], engine: EngineChoice | None) -> str:
    """The beginning of the digest of the code that evaluates in an engine.

    In Bullet it is that of the platform's `code`; in others of it and of the worlds of that engine.
    """
    others = [f"{name}_code" for name in engine_names(engine) if name != DEFAULT_ENGINE]
    code = platform.get("code", "")
    if not others:
        return code[:HEX]
    parts = [code, *(platform.get(name, "") for name in others)]
    return hashlib.sha256("".join(parts).encode()).hexdigest()[:HEX]


def codes_here() -> set[str]:
    """Beginnings of the digests of the installed code, one for each engine."""
    known = {f"{name}_code": syntax_digest(*worlds(engine)) for name, engine in ENGINES.items()}
    known["code"] = code_digest()
    return {code_of(known, name) for name in ENGINES}


def _origin(journal: Journal, rows: Rows, spec: RunSpec) -> Figures:
    """Versions and digests that the rows were made with."""
    platform = journal.platform
    return {
        "version": journal.package,
        "code": code_of(platform, spec.engine),
        "platform": hashlib.sha256(json.dumps(platform, sort_keys=True).encode()).hexdigest()[:HEX],
        "scene": journal.scene[:HEX],
        "journal": rows_digest(rows),
    }


def rows_digest(rows: Rows) -> str:
    """The beginning of the digest of rows, as `qdgrasp digest` prints that of a journal's."""
    return hashlib.sha256(rows.tobytes()).hexdigest()[:HEX]


def figures(folder: RunFolder, rows: Rows, known: ReferenceSet | None) -> Figures:
    """The figures of a run with these rows of its journal."""
    spec, archive = folder.spec, empty_niche_archive(folder)
    total, metrics = count_rows(spec, [rows]), SuccessMetrics(TrialPlan.of(spec))
    metrics.count(rows)
    archive.insert(rows)
    various = diversity(archive)
    return {
        "evaluations": total.evaluations,
        "simulated": total.simulated,
        "proposals": total.proposals,
        "successes": total.successes,
        "grasps": total.grasps,
        "robust": total.robust,
        "cells": total.cells,
        "qd_score": metrics.qd_score,
        "mean_best": metrics.qd_score / total.cells if total.cells else None,
        "near_nu": metrics.nu.below_quarter_pi,
        "niches": various.niches,
        "robust_niches": various.robust_niches,
        "orientations": various.orientations,
        **(covered(SuccessHistory.among(rows, spec.overlaps), known, total.evaluations) if known else {}),
    }


def covered(found: SuccessHistory, known: ReferenceSet, evaluations: int) -> Figures:
    """Coverage of a reference set, in the end and at the milestones that were reached."""
    reached, size = found.found(known), len(known)
    distinct = len(np.unique(cells(found.rows["base_to_object"][:, :3]), axis=0))
    return {
        "set_size": size,
        **{
            f"coverage_{name}": int(reached.after(milestone)) / size
            for name, milestone in MILESTONES.items()
            if milestone <= evaluations
        },
        "coverage": reached.end / size,
        "robust_share": found.found(known, Outcome.HELD).end / size,
        "outside": 1 - reached.end / distinct if distinct else None,
    }


def growth(spec: RunSpec, parts: Sequence[JournalSlice]) -> Figures:
    """Cells with a grasp that survived every disturbance: in the end, and at the milestones reached."""
    rows = np.concatenate([part.rows for part in parts])
    spent = np.cumsum(evaluation_mask(rows, spec.overlaps))
    seconds = np.cumsum(np.concatenate([np.full(len(part), part.cpu_seconds / len(part)) for part in parts]))
    held = SuccessHistory.among(rows, spec.overlaps).cells(Outcome.HELD)
    at_cpu = {
        name: int(spent[np.searchsorted(seconds, second)])
        for name, second in CPU_MILESTONES.items()
        if second <= seconds[-1]
    }
    at = {name: milestone for name, milestone in MILESTONES.items() if milestone <= spent[-1]} | at_cpu
    return {"robust_cells": held.end} | {
        f"robust_cells_{name}": int(held.after(evaluations)) for name, evaluations in at.items()
    }


def costs(parts: Sequence[JournalSlice]) -> Figures:
    """The cost of rows: CPU seconds of the workers, and milliseconds of a success."""
    return {"cpu_seconds": sum(part.cpu_seconds for part in parts), "success_ms": _success_ms(parts)}


def _success_ms(parts: Sequence[JournalSlice]) -> float | None:
    """The cost of a success, where blocks cost what their successes, misses and other rows do."""
    counts = np.array([_counts(part.rows) for part in parts], dtype=np.float64)
    if len(parts) < LEAST or counts[:, 0].sum() < LEAST:
        return None
    weight = 1 / np.sqrt(counts.sum(axis=1))  # a block's noise grows with its rows
    cpu = np.array([part.cpu_seconds for part in parts])
    return 1000 * float(nnls(counts * weight[:, None], cpu * weight)[0][0])


def _counts(rows: Rows) -> tuple[int, int, int]:
    outcome = rows["outcome"]
    success = int(np.count_nonzero(outcome >= Outcome.DROPPED))
    simulated = int(np.count_nonzero(outcome >= Outcome.MISSED))
    return success, simulated - success, len(rows) - simulated


def _with_ratio(found: Figures) -> Figures:
    coverage, seconds = found.get("coverage"), found["cpu_seconds"]
    ratio = float(coverage) / float(seconds) if coverage is not None and seconds else None
    return found | {"coverage_per_cpu_second": ratio}
