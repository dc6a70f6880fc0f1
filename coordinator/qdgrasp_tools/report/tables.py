"""Tables of a campaign: runs, methods, curves and claims as rows, and `tables.md`."""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from qdgrasp_coordinator.metrics.success_metrics import StepSeries
from qdgrasp_protocol.text import counted, first_few
from qdgrasp_tools.report.bootstrap import CONFIDENCE_LEVEL, LEAST_RUNS, LEAST_SCENES, RESAMPLES
from qdgrasp_tools.report.claims import ClaimEvidence, JudgedClaim
from qdgrasp_tools.report.figures import RunVoxels
from qdgrasp_tools.report.run_groups import (
    COVERAGE,
    PUBLISHED_COVERAGE,
    CurvePanel,
    RunGroup,
    SceneName,
    quartile_curve,
    quartiles,
    scene_groups,
)
from qdgrasp_tools.report.run_history import NU_BINS, RunHistory
from qdgrasp_tools.report.setting_sweeps import SettingSweep, SettingValue, run_span, sweep_panels


class Figure(NamedTuple):
    """A number of a run, with its heading and format in tables."""

    heading: str
    """Heading of its column; empty: it is in CSV files alone."""
    words: Callable[[float], str]
    of: Callable[[RunHistory], float | None]


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def _share(found: StepSeries | None, size: int) -> float | None:
    return None if found is None else _ratio(found.end, size)


def _robust_size(run: RunHistory) -> int:
    return len(run.target.reference.robust) if run.target.reference else 0


WHOLE, TWO_PLACES, PERCENT = "{:,.0f}".format, "{:.2f}".format, "{:.2%}".format
FIGURES = {
    "evaluations": Figure("evaluations", WHOLE, lambda run: run.evaluations),
    "simulated": Figure("simulated", WHOLE, lambda run: run.simulated),
    "proposals": Figure("proposals", WHOLE, lambda run: run.proposals),
    "overlaps": Figure("overlaps", WHOLE, lambda run: run.overlaps),
    "dead_ends": Figure("dead ends", WHOLE, lambda run: run.dead_ends),
    "successes": Figure("successes", WHOLE, lambda run: run.successes),
    "cells": Figure("cells", WHOLE, lambda run: run.cells.end),
    "robust_cells": Figure("robust cells", WHOLE, lambda run: run.robust_cells.end),
    "niches": Figure("niches", WHOLE, lambda run: run.diversity.niches),
    "grasp_niches": Figure("", WHOLE, lambda run: run.diversity.grasp_niches),
    "robust_niches": Figure("robust niches", WHOLE, lambda run: run.diversity.robust_niches),
    "orientations_per_cell": Figure(
        "orientations per cell", TWO_PLACES, lambda run: run.diversity.orientations
    ),
    "synergies_per_cell": Figure("synergies per cell", TWO_PLACES, lambda run: run.diversity.synergies),
    "mean_best": Figure("mean best fitness", TWO_PLACES, lambda run: _ratio(run.qd_score, run.cells.end)),
    "qd_score": Figure("QD score", WHOLE, lambda run: run.qd_score),
    "success_share": Figure(
        "success share", "{:.1%}".format, lambda run: _ratio(run.successes, run.evaluations)
    ),
    "coverage": Figure("coverage", PERCENT, lambda run: _share(run.found, run.target.size)),
    "published_coverage": Figure(
        "coverage as published", PERCENT, lambda run: _share(run.published, run.target.size)
    ),
    "robust_coverage": Figure(
        "robust coverage", PERCENT, lambda run: _share(run.robust_found, _robust_size(run))
    ),
    "nu_below_quarter_pi": Figure("nu < pi/4", "{:.0%}".format, lambda run: run.near_share),
    "eta": Figure("eta", TWO_PLACES, lambda run: None if run.eta is None else run.eta.mean),
    "trials_per_success": Figure(
        "trials of a success", WHOLE, lambda run: None if run.eta is None else run.eta.trials
    ),
    "rate": Figure(
        "evaluations per CPU s",
        lambda x: f"{x:,.0f}" if x >= 10 else f"{x:.2g}",
        lambda run: _ratio(run.evaluations, run.cpu_seconds),
    ),
    "cpu_seconds": Figure("CPU s", WHOLE, lambda run: run.cpu_seconds),
}
"""Columns of all tables of runs, in their order."""
Value = str | int | float | None
Row = dict[str, Value]  # Columns by name; None where there is no number


def run_rows(groups: Iterable[RunGroup]) -> list[Row]:
    """One row for each run."""
    return [
        _group_columns(group)
        | {
            "run": run.path.name,
            "seed": run.spec.seed,
            "overlaps_mode": run.spec.overlaps,
            "finished": "yes" if run.complete else "no",
            **{name: figure.of(run) for name, figure in FIGURES.items()},
            "set_size": run.target.size or None,
            "stand_in": ("yes" if run.target.stand_in else "no") if run.target.size else None,
            "why_no_set": run.target.why,
        }
        for group in groups
        for run in group.runs
    ]


def method_rows(groups: Iterable[RunGroup]) -> list[Row]:
    """One row for each group: of each figure, median and quartiles over runs that have begun."""
    rows = []
    for group in groups:
        begun = [run for run in group.runs if run.evaluations]
        row: Row = _group_columns(group) | {"overlaps_mode": group.overlaps}
        row |= {"seeds": len(group.runs), "unfinished": group.unfinished}
        for name, figure in FIGURES.items():
            values = np.array([[figure.of(run)] for run in begun], dtype=np.float64).reshape(-1, 1)
            low, median, high = quartiles(values)[:, 0].tolist() if len(values) else [np.nan] * 3
            row |= {name: _or_none(median), f"{name}_q1": _or_none(low), f"{name}_q3": _or_none(high)}
        rows.append(row)
    return rows


def curve_rows(panels: Iterable[CurvePanel]) -> list[Row]:
    """One row for each point of each curve, with the count as published beside it."""
    rows: list[Row] = []
    for one in (curve for panel in panels for curve in panel.curves):
        published = quartile_curve(one.group, PUBLISHED_COVERAGE)
        columns = (one.evaluations, one.runs, one.low, one.median, one.high, published.median)
        for evaluations, runs, low, median, high, other in zip(*(c.tolist() for c in columns), strict=True):
            rows.append(_group_columns(one.group) | {
                "measure": one.measure.name, "evaluations": evaluations, "runs": runs,
                "q1": _or_none(low), "median": _or_none(median), "q3": _or_none(high),
                "published_median": _or_none(other),
            })  # fmt: skip
    return rows


def nu_rows(groups: Iterable[RunGroup]) -> list[Row]:
    """One row for each bin of nu of each run with a nu: its edges [deg] and the successes in it."""
    edges = np.linspace(0, 180, NU_BINS + 1).tolist()
    return [
        _group_columns(group)
        | {"run": run.path.name, "evaluations": run.evaluations, "from": low, "to": high, "successes": count}
        for group in groups
        for run in group.runs
        if run.nu.any()
        for low, high, count in zip(edges[:-1], edges[1:], run.nu.tolist(), strict=True)
    ]


def voxel_rows(shown: RunVoxels) -> list[Row]:
    """One row for each cell with a success: its place [cm], CoM frame, and the best in it."""
    columns = scene_columns(shown.name) | {"method": shown.run.spec.method, "run": shown.run.path.name}
    measure = "fitness" if shown.eta is None else "eta"
    return [
        columns | {"x": x, "y": y, "z": z, measure: best}
        for (x, y, z), best in zip(shown.places.tolist(), shown.worth.tolist(), strict=True)
    ]


def sweep_rows(sweep: SettingSweep) -> list[Row]:
    """One row for each value of a sweep: what was reached with it, over its runs."""
    columns = scene_columns(sweep.scene) | {"method": sweep.group.method, "variant": sweep.variant}
    columns |= {"measure": sweep.measure.name, "evaluations": sweep.evaluations, "setting": sweep.setting}
    return [
        columns
        | {"value": one.value, "is_default": "yes" if one is sweep.default else "no"}
        | dict(zip(("runs", "least", "median", "greatest"), (len(one.reached), *one.range), strict=True))
        for one in sweep.values
    ]


def claim_rows(claims: Iterable[JudgedClaim]) -> list[Row]:
    """One row for each number of each claim; a claim without numbers has one row that says so."""
    rows: list[Row] = []
    for one in claims:
        columns: Row = {"claim": one.claim.letter, "words": one.claim.words, "verdict": one.verdict.value}
        rows += [columns | _evidence_row(one, found, judged) for found, judged in one.numbers] or [columns]
    return rows


def _evidence_row(one: JudgedClaim, evidence: ClaimEvidence, judged: bool) -> Row:
    found = evidence.interval
    upper, *lower = found.runs
    return {
        "subject": evidence.subject,
        "statistic": evidence.statistic,
        "value": _or_none(found.value),
        "low": _or_none(found.low),
        "high": _or_none(found.high),
        "criterion": one.claim.criterion if judged else "to compare with",
        "number_verdict": one.claim.band.verdict(found).value if judged else "",
        "scenes": found.scenes,
        "runs": upper,
        "runs_below": lower[0] if lower else None,
        "least_evaluations": min(evidence.evaluations),
        "most_evaluations": max(evidence.evaluations),
    }


def scene_columns(scene: SceneName) -> Row:
    """The columns that name a scene."""
    return {"gripper": scene.gripper, "object": scene.object, "protocol": scene.protocol}


def _group_columns(group: RunGroup) -> Row:
    return scene_columns(group.scene) | {"method": group.method, "variant": group.variant}


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else value


def csv_text(rows: Sequence[Mapping[str, Value]]) -> str:
    """Write rows as CSV, columns in the order of their first occurrence; None is empty."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


MOST_NAMED = 10  # So many runs of a kind are named
CLAIMS_HEADING = "## What the paper claims"
CAPTIONS = {
    "comparison": "The paper's first figure of results: for each hand the standard sampling schemes, dashed, "
    "and searches with the least prior. For each seed the mean over those objects that have an S_G and that "
    "all of these methods were run on; of fewer than two with an S_G success cells, over all such objects. "
    "Median and interquartile range over seeds.",
    "variants": "The paper's second figure: each search with each prior, taken over objects alike.",
    "nu": "How successes of the contact-based methods lean from the surface normal, by hand: mean over "
    "scenes of the mean over runs. Dashed: pi/4. `nu.csv` has the methods with other priors too: `approach` "
    "is bound to pi/4, and antipodal hands stand beside the line between their two points, near pi/2.",
    "voxels": "Cells of 1 cm with a success, by the most robust one in each, in the run with the median "
    "number of cells. Views of one object have one camera and one scale, for all hands and methods.",
    "coverage": "Every method on every scene: median over seeds and interquartile range. Coverage is "
    "de-duplicated (distinct entries of S_G found, over its size); where a scene has no S_G, success cells "
    "of 1 cm are counted instead and the panel says so. `coverage.csv` has the count as published beside it.",
    "priors": "Hands and scenes prior by prior; grey: the other priors.",
    "settings": "Results by the value of a setting that differs within a method, all else equal, "
    "after as many evaluations of each run.",
}
COUNTED = {"count": "every genome", "redraw": "the simulated"}
"""Meaning of an evaluation, by whether overlaps count."""


def markdown_page(
    name: str,
    groups: Sequence[RunGroup],
    claims: Sequence[JudgedClaim],
    figures: Mapping[str, str],
    sweeps: Sequence[SettingSweep] = (),
    left_out: tuple[Sequence[str], Sequence[str]] = ((), ()),
) -> str:
    """Write an analysis as a page; `figures` gives the reason why one was left out."""
    parts = (
        f"# {name}\n",
        _overview(groups),
        *(f"{sentence}\n" for sentence in left_out_words(*left_out)),
        f"{CLAIMS_HEADING}\n",
        _claims(claims),
        *(_figure(figure, missing) for figure, missing in figures.items()),
        *_sweeps(sweeps),
        "## Numbers of each method\n",
        "Median over runs that have begun [first quartile, third quartile]; *n* is the number of runs. "
        "`methods.csv` and `runs.csv` have the numbers. Coverage is of S_G; robust coverage is of its "
        "entries of fitness 2, by successes of fitness 2. *Counted* says what an evaluation is: compare "
        "methods that count alike, or look at proposals and CPU time.\n",
        *_scenes(groups),
    )
    return "\n".join(parts)


def left_out_words(without_curves: Sequence[str], repeats: Sequence[str]) -> Iterator[str]:
    """Yield sentences on runs of which too little was kept for curves, and on repeated ones."""
    for runs, why in (
        (without_curves, "of which only the successes were kept"),
        (repeats, "as other runs are of the same search, and as long or longer"),
    ):
        if runs:
            left_out = counted(len(runs), "run is", "runs are")
            yield f"{left_out} left out, {why}: {first_few(runs, MOST_NAMED)}."


def _overview(groups: Sequence[RunGroup]) -> str:
    runs = [run for group in groups for run in group.runs]
    going = [run for run in runs if not run.complete]
    names = [f"`{run.path.name}` ({run.evaluations:,} of {run.spec.evaluations:,})" for run in going]
    more = ", see `runs.csv`" if len(going) > MOST_NAMED else ""
    scenes, evaluations = {group.scene for group in groups}, sum(run.evaluations for run in runs)
    spent = counted(evaluations, "evaluation", told="{:,}".format)
    unfinished = f" {len(going)} unfinished: {first_few(names, MOST_NAMED)}{more}." if going else ""
    return f"{counted(len(runs), 'run')} on {counted(len(scenes), 'scene')}, {spent}.{unfinished}\n"


def _claims(claims: Sequence[JudgedClaim]) -> str:
    summary = markdown_table(
        ("", "claim", "verdict", "what agreeing means"),
        [(one.claim.letter, one.claim.words, _verdict(one), one.claim.criterion) for one in claims],
    )
    interval = f"{CONFIDENCE_LEVEL:.0%} interval"
    numbers = markdown_table(
        ("", "number", "value", interval, "this number", "evaluations", "scenes", "runs"),
        [line for one in claims for line in _number_lines(one)],
    )
    notes = (
        f"Intervals: studentised hierarchical bootstrap, {RESAMPLES:,} resamples of scenes and of the runs "
        f"in each; with fewer than {LEAST_SCENES} scenes of the runs alone, for these scenes and no others. "
        f"Where an arm has fewer than {LEAST_RUNS} runs on a scene, or nothing was found, there is none, and "
        "no verdict. Methods are compared after as many evaluations, of finished runs where there are any.\n"
    )
    return "\n".join([summary, numbers, notes])


def _verdict(one: JudgedClaim) -> str:
    lacking = f" ({one.absent_count} of {len(one.claim.methods)} numbers not in this campaign)"
    is_partial = one.absent_count and one.evidence
    return f"**{one.verdict.value}**{lacking if is_partial else ''}"


FEW_RUNS = f"none: fewer than {LEAST_RUNS} runs"
NOTHING_FOUND = "none: nothing was found"


def _number_lines(one: JudgedClaim) -> Iterable[tuple[str, ...]]:
    for found, is_judged in one.numbers:
        interval, (low, high) = found.interval, (min(found.evaluations), max(found.evaluations))
        verdict = one.claim.band.verdict(interval).value
        missing = FEW_RUNS if interval.scenes else NOTHING_FOUND
        yield (
            one.claim.letter,
            f"`{found.subject}`: {found.statistic}",
            f"{interval.value:.3g}",
            f"{interval.low:.3g} to {interval.high:.3g}" if interval.is_known else missing,
            verdict if is_judged else "to compare with",
            f"{low:,}" if low == high else f"{low:,} to {high:,}",
            str(interval.scenes),
            " / ".join(map(str, interval.runs)),
        )


def _figure(name: str, missing: str) -> str:
    shown = f"Not drawn: {missing}." if missing else f"![{name}]({name}.png)\n\n{CAPTIONS[name]}"
    return f"## {name.capitalize()}\n\n{shown}\n"


def _sweeps(sweeps: Sequence[SettingSweep]) -> Iterable[str]:
    """Yield a table for each setting and scene: a row for each method, a column for each value."""
    for (setting, scene), here in sweep_panels(sweeps).items():
        values = sorted({one.value for sweep in here for one in sweep.values})
        yield f"{scene.words}, {here[0].measure.words}, {run_span(here)}: median [least, greatest].\n"
        yield markdown_table(
            (setting, *(f"{value:g}" for value in values), "best", "default over best"),
            [_sweep_line(sweep, values) for sweep in here],
        )


def _sweep_line(sweep: SettingSweep, values: Sequence[float]) -> tuple[str, ...]:
    words = PERCENT if sweep.measure is COVERAGE else WHOLE
    found = {one.value: one for one in sweep.values}

    def cell(one: SettingValue | None) -> str:
        if one is None:
            return ""
        least, median, greatest = map(words, one.range)
        return f"{median} [{least}, {greatest}]{' default' if one is sweep.default else ''}"

    name = " ".join(sweep.method_variant).rstrip()
    return name, *(cell(found.get(value)) for value in values), *_best_words(sweep)


def _best_words(sweep: SettingSweep) -> tuple[str, str]:
    """Name the best value, and compare the default with it by their medians and ranges."""
    best, default = sweep.best, sweep.default
    if not best.range[1]:
        return "", "nothing was found"
    if default is None:
        return f"{best.value:g}", "not among them"
    if default is best:
        return f"{best.value:g}", "it is the best"
    ratio = default.range[1] / best.range[1]
    overlap = "overlap" if default.range[2] >= best.range[0] else "do not overlap"
    return f"{best.value:g}", f"{ratio:.2f}, ranges {overlap}"


def _scenes(groups: Sequence[RunGroup]) -> Iterable[str]:
    for scene, here in scene_groups(groups).items():
        yield f"### {scene.words}\n"
        target = here[0].target
        mark = ", by a stand-in for the scan" if target.stand_in else ""
        if target.reference is None:
            yield f"No coverage: {target.why}.\n"
        else:
            yield f"S_G has {target.size:,} entries{mark}.\n"
        yield _methods(here)


def _methods(groups: Sequence[RunGroup]) -> str:
    rows = method_rows(groups)
    headed = [name for name, figure in FIGURES.items() if figure.heading]
    shown = [name for name in headed if any(row[name] is not None for row in rows)]
    body = [
        (group.name, _run_counts(group), COUNTED[group.overlaps], *(_quartiles(row, name) for name in shown))
        for group, row in zip(groups, rows, strict=True)
    ]
    return markdown_table(("method", "n", "counted", *(FIGURES[name].heading for name in shown)), body)


def _run_counts(group: RunGroup) -> str:
    return f"{len(group.runs)}{f', {group.unfinished} unfinished' if group.unfinished else ''}"


def _quartiles(row: Row, name: str) -> str:
    values: list[Any] = [row[name], row[f"{name}_q1"], row[f"{name}_q3"]]
    if values[0] is None:
        return ""
    median, low, high = map(FIGURES[name].words, values)
    return median if low == high == median else f"{median} [{low}, {high}]"


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
