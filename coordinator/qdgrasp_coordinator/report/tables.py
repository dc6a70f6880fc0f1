"""Tables of a campaign: runs, methods, curves and claims as rows, and `tables.md`."""

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from qdgrasp_coordinator.report.claims import (
    CONFIDENCE_LEVEL,
    FEW_RUNS,
    RESAMPLES,
    ClaimEvidence,
    ConfidenceInterval,
    JudgedClaim,
)
from qdgrasp_coordinator.report.figures import RunVoxels
from qdgrasp_coordinator.report.run_groups import (
    PUBLISHED_COVERAGE,
    QuartileCurve,
    RunGroup,
    SceneName,
    quartile_curve,
    quartiles,
)
from qdgrasp_coordinator.report.run_history import NU_BINS, RunHistory
from qdgrasp_protocol.text import counted, first_few

Value = str | int | float | None
Row = dict[str, Value]  # Columns by name; None where there is no number


def run_rows(entries: Iterable[RunGroup]) -> list[Row]:
    """One row for each run."""
    return [
        _group_columns(entry)
        | {
            "run": run.path.name,
            "seed": run.spec.seed,
            "overlaps_mode": run.spec.overlaps,
            "finished": "yes" if run.complete else "no",
            **run_figures(run),
            "set_size": run.target.size or None,
            "stand_in": ("yes" if run.target.stand_in else "no") if run.target.size else None,
            "why_no_set": run.target.why,
        }
        for entry in entries
        for run in entry.runs
    ]


def run_figures(run: RunHistory) -> dict[str, float | int | None]:
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


def method_rows(entries: Iterable[RunGroup]) -> list[Row]:
    """One row for each entry: of each figure the median over its runs that have begun, and the quartiles."""
    rows = []
    for entry in entries:
        begun = [run for run in entry.runs if run.evaluations]
        row: Row = _group_columns(entry) | {"overlaps_mode": entry.overlaps}
        row |= {"seeds": len(entry.runs), "unfinished": entry.unfinished}
        for name in run_figures(entry.runs[0]):
            values = np.array([[run_figures(run)[name]] for run in begun], dtype=np.float64).reshape(-1, 1)
            low, median, high = quartiles(values)[:, 0].tolist() if len(values) else [np.nan] * 3
            row |= {name: _or_none(median), f"{name}_q1": _or_none(low), f"{name}_q3": _or_none(high)}
        rows.append(row)
    return rows


def curve_rows(curves: Iterable[QuartileCurve]) -> list[Row]:
    """One row for each point of each curve, with the count as published beside it."""
    return [row for one in curves for row in _curve_points(one)]


def _curve_points(one: QuartileCurve) -> Iterable[Row]:
    published = quartile_curve(one.entry, PUBLISHED_COVERAGE)
    columns = (one.evaluations, one.runs, one.low, one.median, one.high, published.median)
    for evaluations, runs, low, median, high, other in zip(*(c.tolist() for c in columns), strict=True):
        yield _group_columns(one.entry) | {
            "measure": one.measure.name, "evaluations": evaluations, "runs": runs,
            "q1": _or_none(low), "median": _or_none(median), "q3": _or_none(high),
            "published_median": _or_none(other),
        }  # fmt: skip


def nu_rows(entries: Iterable[RunGroup]) -> list[Row]:
    """One row for each bin of nu of each run with a nu: its edges [deg] and the successes in it."""
    edges = np.linspace(0, 180, NU_BINS + 1).tolist()
    return [
        _group_columns(entry)
        | {"run": run.path.name, "evaluations": run.evaluations, "from": low, "to": high, "successes": count}
        for entry in entries
        for run in entry.runs
        if run.nu.any()
        for low, high, count in zip(edges[:-1], edges[1:], run.nu.tolist(), strict=True)
    ]


def voxel_rows(shown: RunVoxels) -> list[Row]:
    """One row for each cell of a run with a success: its place [cm], CoM frame, and the best one in it."""
    said = scene_columns(shown.name) | {"method": shown.run.spec.method, "run": shown.run.path.name}
    measure = "fitness" if shown.eta is None else "eta"
    return [
        said | {"x": x, "y": y, "z": z, measure: best}
        for (x, y, z), best in zip(shown.places.tolist(), shown.worth.tolist(), strict=True)
    ]


def claim_rows(claims: Iterable[JudgedClaim]) -> list[Row]:
    """One row for each number of each claim; a claim without numbers has one row that says so."""
    rows: list[Row] = []
    for one in claims:
        said: Row = {"claim": one.claim.letter, "words": one.claim.words, "verdict": one.verdict.value}
        numbers = [(finding, True) for finding in one.findings] + [(finding, False) for finding in one.beside]
        rows += [said | _evidence_row(one, finding, judged) for finding, judged in numbers] or [said]
    return rows


def _evidence_row(one: JudgedClaim, finding: ClaimEvidence, judged: bool) -> Row:
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


def _group_columns(entry: RunGroup) -> Row:
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


MOST_NAMED = 10  # So many runs of a kind are named
CLAIMS_HEADING = "## What the paper claims"
FEW_MARK = " \\*"  # Of what few runs are behind
CAPTIONS = {
    "coverage": "Every method over its evaluations: median over seeds and interquartile range. Coverage is "
    "de-duplicated (distinct entries of S_G found, over its size); where a scene has no S_G, success cells "
    "of 1 cm are counted instead and the panel says so. `coverage.csv` has the count as published beside it.",
    "hands": "The same for each hand: for each seed the mean of its coverage over those objects that have an "
    "S_G and that all methods were run on; median and interquartile range over seeds.",
    "priors": "Both prior by prior; grey: the other priors.",
    "nu": "How successes lean from the surface normal: mean over scenes of the mean over runs. Dashed: pi/4. "
    "Antipodal hands stand beside the line between their two points, with nu near pi/2 by construction: "
    "they are in `nu.csv` alone.",
    "voxels": "Cells of 1 cm with a success, by the most robust one in each, in the run with the median "
    "number of cells.",
}
FIGURES: dict[str, tuple[str, Callable[[float], str]]] = {
    "evaluations": ("evaluations", lambda x: f"{x:,.0f}"),
    "simulated": ("simulated", lambda x: f"{x:,.0f}"),
    "proposals": ("proposals", lambda x: f"{x:,.0f}"),
    "overlaps": ("overlaps", lambda x: f"{x:,.0f}"),
    "dead_ends": ("dead ends", lambda x: f"{x:,.0f}"),
    "successes": ("successes", lambda x: f"{x:,.0f}"),
    "cells": ("cells", lambda x: f"{x:,.0f}"),
    "robust_cells": ("robust cells", lambda x: f"{x:,.0f}"),
    "niches": ("niches", lambda x: f"{x:,.0f}"),
    "robust_niches": ("robust niches", lambda x: f"{x:,.0f}"),
    "orientations_per_cell": ("orientations per cell", lambda x: f"{x:.2f}"),
    "synergies_per_cell": ("synergies per cell", lambda x: f"{x:.2f}"),
    "mean_best": ("mean best fitness", lambda x: f"{x:.2f}"),
    "qd_score": ("QD score", lambda x: f"{x:,.0f}"),
    "success_share": ("success share", lambda x: f"{x:.1%}"),
    "coverage": ("cvg, de-duplicated", lambda x: f"{x:.2%}"),
    "published": ("cvg as published", lambda x: f"{x:.2%}"),
    "robust": ("robust cvg", lambda x: f"{x:.2%}"),
    "nu_below_quarter_pi": ("nu < pi/4", lambda x: f"{x:.0%}"),
    "eta": ("eta", lambda x: f"{x:.2f}"),
    "rate": ("evaluations per CPU s", lambda x: f"{x:,.0f}" if x >= 10 else f"{x:.2g}"),
    "cpu_seconds": ("CPU s", lambda x: f"{x:,.0f}"),
}
"""Columns of a scene's table, with how their numbers are written."""
COUNTED = {"count": "every genome", "redraw": "the simulated"}
"""What an evaluation is, by whether overlaps count."""


def markdown_page(
    name: str,
    entries: Sequence[RunGroup],
    claims: Sequence[JudgedClaim],
    figures: Mapping[str, str],
    without_curves: Sequence[str] = (),
) -> str:
    """All of an analysis in words; `figures` says why one was left out."""
    parts = [
        f"# {name}\n",
        _overview(entries),
        *([f"{left_out_words(without_curves)}\n"] if without_curves else []),
        f"{CLAIMS_HEADING}\n",
        _claims(claims),
        *(_figure(figure, missing) for figure, missing in figures.items()),
        "## Methods\n",
        "Median over runs that have begun [first quartile, third quartile]; *n* is the number of runs. "
        "`methods.csv` and `runs.csv` have the numbers. Coverage is of S_G; robust coverage is of its "
        "entries of fitness 2, by successes of fitness 2. *Counted* says what an evaluation is: compare "
        "methods that count alike, or look at proposals and CPU time.\n",
        *_scenes(entries),
    ]
    return "\n".join(parts)


def left_out_words(runs: Sequence[str]) -> str:
    """What is said of runs whose history cannot be told any more, by their names."""
    verb = "run is" if len(runs) == 1 else "runs are"
    return (
        f"{len(runs)} {verb} left out, of which only the successes were kept: {first_few(runs, MOST_NAMED)}."
    )


def _overview(entries: Sequence[RunGroup]) -> str:
    runs = [run for entry in entries for run in entry.runs]
    going = [run for run in runs if not run.complete]
    said = [f"`{run.path.name}` ({run.evaluations:,} of {run.spec.evaluations:,})" for run in going]
    more = ", see `runs.csv`" if len(going) > MOST_NAMED else ""
    scenes, evaluations = {entry.scene for entry in entries}, sum(run.evaluations for run in runs)
    spent = counted(evaluations, "evaluation", told="{:,}".format)
    unfinished = f" {len(going)} unfinished: {first_few(said, MOST_NAMED)}{more}." if going else ""
    return f"{counted(len(runs), 'run')} on {counted(len(scenes), 'scene')}, {spent}.{unfinished}\n"


def _claims(claims: Sequence[JudgedClaim]) -> str:
    summary = markdown_table(
        ("", "claim", "verdict", "what agreeing means"),
        [(one.claim.letter, one.claim.words, _verdict(one), one.claim.criterion) for one in claims],
    )
    numbers = markdown_table(
        (
            "",
            "number",
            "value",
            f"{CONFIDENCE_LEVEL:.0%} interval",
            "this number",
            "evaluations",
            "scenes",
            "runs",
        ),
        [
            (
                one.claim.letter,
                f"`{found.subject}`: {found.statistic}",
                *_number(found.interval),
                verdict,
                *_sample(found),
            )
            for one in claims
            for found, verdict in _judged(one)
        ],
    )
    notes = (
        f"Intervals: hierarchical bootstrap, {RESAMPLES:,} resamples of scenes and of the runs in each. "
        "With one scene they speak of that scene alone. Methods are compared after as many evaluations, "
        "with finished runs only where there are any.\n\n"
        f"\\* Fewer than {FEW_RUNS} runs: such an interval is narrower than it says, and its verdict is "
        "provisional; of two runs, it reaches from one to the other.\n"
    )
    return "\n".join([summary, numbers, notes])


def _verdict(one: JudgedClaim) -> str:
    lacking = (
        f" ({one.absent} of {len(one.claim.methods)} numbers not in this campaign)" if one.absent else ""
    )
    return f"**{one.verdict.value}**{FEW_MARK if one.is_of_few else ''}{lacking if one.findings else ''}"


def _judged(one: JudgedClaim) -> Iterable[tuple[ClaimEvidence, str]]:
    for found in one.findings:
        yield found, one.claim.band.verdict(found.interval).value + (FEW_MARK if found.is_of_few else "")
    for found in one.beside:
        yield found, "to compare with"


def _number(found: ConfidenceInterval) -> tuple[str, str]:
    interval = f"{found.low:.3g} to {found.high:.3g}" if found.is_known else "none: one run"
    return f"{found.value:.3g}", interval


def _sample(found: ClaimEvidence) -> tuple[str, str, str]:
    low, high = min(found.evaluations), max(found.evaluations)
    ends = f"{low:,}" if low == high else f"{low:,} to {high:,}"
    return ends, str(found.interval.scenes), " / ".join(map(str, found.interval.runs))


def _figure(name: str, missing: str) -> str:
    if missing:
        return f"## {name.capitalize()}\n\nNot drawn: {missing}.\n"
    return f"## {name.capitalize()}\n\n![{name}]({name}.png)\n\n{CAPTIONS[name]}\n"


def _scenes(entries: Sequence[RunGroup]) -> Iterable[str]:
    scenes: dict[SceneName, list[RunGroup]] = {}
    for entry in entries:
        scenes.setdefault(entry.scene, []).append(entry)
    for scene, here in scenes.items():
        yield f"### {scene.words}\n"
        yield _target_words(here[0])
        yield _methods(here)


def _target_words(entry: RunGroup) -> str:
    target = entry.target
    if not target.size:
        return f"No coverage: {target.why}.\n"
    mark = ", by a stand-in for the scan" if target.stand_in else ""
    return f"S_G has {target.size:,} entries{mark}.\n"


def _methods(entries: Sequence[RunGroup]) -> str:
    rows = method_rows(entries)
    shown = [name for name in FIGURES if any(row[name] is not None for row in rows)]
    body = [
        (entry.name, _runs(entry), COUNTED[entry.overlaps], *(_quartiles(row, name) for name in shown))
        for entry, row in zip(entries, rows, strict=True)
    ]
    return markdown_table(("method", "n", "counted", *(FIGURES[name][0] for name in shown)), body)


def _runs(entry: RunGroup) -> str:
    return f"{len(entry.runs)}{f', {entry.unfinished} unfinished' if entry.unfinished else ''}"


def _quartiles(row: Row, name: str) -> str:
    values: list[Any] = [row[name], row[f"{name}_q1"], row[f"{name}_q3"]]
    if values[0] is None:
        return ""
    median, low, high = map(FIGURES[name][1], values)
    return median if low == high == median else f"{median} [{low}, {high}]"


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
