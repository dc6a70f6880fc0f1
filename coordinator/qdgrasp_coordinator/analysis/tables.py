"""Tables: the figures of runs, of methods, and of claims, as rows of plain values."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from qdgrasp_coordinator.analysis.claims import Judged
from qdgrasp_coordinator.analysis.curves import PUBLISHED, Curve, curve, quartiles
from qdgrasp_coordinator.analysis.entries import Entry, SceneName
from qdgrasp_coordinator.analysis.findings import Finding
from qdgrasp_coordinator.analysis.history import NU_BINS, History
from qdgrasp_coordinator.analysis.voxel_figure import Voxels

Value = str | int | float | None
Row = dict[str, Value]
"""Columns by name; None where there is no number."""


def run_rows(entries: Iterable[Entry]) -> list[Row]:
    """One row for each run."""
    return [
        _arm(entry)
        | {
            "run": run.path.name,
            "seed": run.spec.seed,
            "overlaps_mode": run.spec.overlaps,
            "finished": "yes" if run.complete else "no",
            **figures(run),
            "set_size": run.target.size or None,
            "stand_in": ("yes" if run.target.stand_in else "no") if run.target.size else None,
            "why_no_set": run.target.why,
        }
        for entry in entries
        for run in entry.runs
    ]


def figures(run: History) -> dict[str, float | int | None]:
    """The figures of a run."""
    known = run.target.reference
    return {
        "evaluations": run.evaluations,
        "simulated": run.simulated,
        "proposals": run.proposals,
        "overlaps": run.overlaps,
        "dead_ends": run.dead_ends,
        "successes": run.successes,
        "cells": run.cells.end,
        "robust_cells": run.robust_cells.end,
        "niches": run.diversity.niches,
        "grasp_niches": run.diversity.grasp_niches,
        "robust_niches": run.diversity.robust_niches,
        "orientations_per_cell": run.diversity.orientations,
        "synergies_per_cell": run.diversity.synergies,
        "mean_best": _ratio(run.qd_score, run.cells.end),
        "qd_score": run.qd_score,
        "success_share": _ratio(run.successes, run.evaluations),
        "coverage": None if run.found is None else _ratio(run.found.end, run.target.size),
        "published": None if run.published is None else _ratio(run.published.end, run.target.size),
        "robust": None
        if known is None or run.robust_found is None
        else _ratio(run.robust_found.end, len(known.robust)),
        "nu_below_quarter_pi": run.near_share,
        "eta": run.eta,
        "rate": _ratio(run.evaluations, run.cpu_seconds),
        "cpu_seconds": run.cpu_seconds,
    }


def method_rows(entries: Iterable[Entry]) -> list[Row]:
    """One row for each entry: of each figure the median over its runs that have begun, and the quartiles."""
    rows = []
    for entry in entries:
        begun = [run for run in entry.runs if run.evaluations]
        row: Row = _arm(entry) | {"overlaps_mode": entry.overlaps}
        row |= {"seeds": len(entry.runs), "unfinished": entry.unfinished}
        for name in figures(entry.runs[0]):
            values = np.array([[figures(run)[name]] for run in begun], dtype=np.float64).reshape(-1, 1)
            low, median, high = quartiles(values)[:, 0].tolist() if len(values) else [np.nan] * 3
            row |= {name: _or_none(median), f"{name}_q1": _or_none(low), f"{name}_q3": _or_none(high)}
        rows.append(row)
    return rows


def curve_rows(curves: Iterable[Curve]) -> list[Row]:
    """One row for each point of each curve, with the count as published beside it."""
    return [row for one in curves for row in _points(one)]


def _points(one: Curve) -> Iterable[Row]:
    published = curve(one.entry, PUBLISHED)
    columns = (one.evaluations, one.runs, one.low, one.median, one.high, published.median)
    for evaluations, runs, low, median, high, other in zip(*(c.tolist() for c in columns), strict=True):
        yield _arm(one.entry) | {
            "measure": one.measure.name, "evaluations": evaluations, "runs": runs,
            "q1": _or_none(low), "median": _or_none(median), "q3": _or_none(high),
            "published_median": _or_none(other),
        }  # fmt: skip


def nu_rows(entries: Iterable[Entry]) -> list[Row]:
    """One row for each bin of nu of each run with a nu: its edges [deg] and the successes in it."""
    edges = np.linspace(0, 180, NU_BINS + 1).tolist()
    return [
        _arm(entry)
        | {"run": run.path.name, "evaluations": run.evaluations, "from": low, "to": high, "successes": count}
        for entry in entries
        for run in entry.runs
        if run.nu.any()
        for low, high, count in zip(edges[:-1], edges[1:], run.nu.tolist(), strict=True)
    ]


def voxel_rows(shown: Voxels) -> list[Row]:
    """One row for each cell of a run with a success: its place [cm], CoM frame, and the best one in it."""
    said = scene_columns(shown.name) | {"method": shown.run.spec.method, "run": shown.run.path.name}
    measure = "fitness" if shown.eta is None else "eta"
    return [
        said | {"x": x, "y": y, "z": z, measure: best}
        for (x, y, z), best in zip(shown.places.tolist(), shown.worth.tolist(), strict=True)
    ]


def claim_rows(claims: Iterable[Judged]) -> list[Row]:
    """One row for each number of each claim; a claim without numbers has one row that says so."""
    rows: list[Row] = []
    for one in claims:
        said: Row = {"claim": one.claim.letter, "words": one.claim.words, "verdict": one.verdict.value}
        numbers = [(finding, True) for finding in one.findings] + [(finding, False) for finding in one.beside]
        rows += [said | _finding(one, finding, judged) for finding, judged in numbers] or [said]
    return rows


def _finding(one: Judged, finding: Finding, judged: bool) -> Row:
    found = finding.interval
    upper, *lower = found.runs
    return {
        "subject": finding.subject,
        "statistic": finding.statistic,
        "value": _or_none(found.value),
        "low": _or_none(found.low),
        "high": _or_none(found.high),
        "criterion": one.claim.criterion if judged else "to compare with",
        "number_verdict": one.claim.band.verdict(found).value if judged else "",
        "scenes": found.scenes,
        "runs": upper,
        "runs_below": lower[0] if lower else None,
        "least_evaluations": min(finding.evaluations),
        "most_evaluations": max(finding.evaluations),
    }


def scene_columns(scene: SceneName) -> Row:
    """The columns that name a scene."""
    return {"gripper": scene.gripper, "object": scene.object, "protocol": scene.protocol}


def _arm(entry: Entry) -> Row:
    return scene_columns(entry.scene) | {"method": entry.method, "variant": entry.variant}


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else value


def csv_text(rows: Sequence[Mapping[str, Value]]) -> str:
    """Rows as CSV; columns in the order in which they first occur, nothing where there is no number."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
