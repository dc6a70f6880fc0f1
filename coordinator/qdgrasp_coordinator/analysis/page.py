"""The page of an analysis, `tables.md`: claims, captions and figures in words."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from qdgrasp_coordinator.analysis.bootstrap import LEVEL, RESAMPLES, Interval
from qdgrasp_coordinator.analysis.claims import Judged
from qdgrasp_coordinator.analysis.entries import Entry, SceneName
from qdgrasp_coordinator.analysis.findings import FEW, Finding
from qdgrasp_coordinator.analysis.tables import Row, method_rows
from qdgrasp_protocol.phrases import counted, few

NAMED = 10
"""So many runs of a kind are named."""
CLAIMS = "## What the paper claims"
MARK = " \\*"
"""Of what few runs are behind."""
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


def page(
    name: str,
    entries: Sequence[Entry],
    claims: Sequence[Judged],
    figures: Mapping[str, str],
    without_curves: Sequence[str] = (),
) -> str:
    """All of an analysis in words; `figures` says why one was left out."""
    parts = [
        f"# {name}\n",
        _overview(entries),
        *([f"{left_out(without_curves)}\n"] if without_curves else []),
        f"{CLAIMS}\n",
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


def left_out(runs: Sequence[str]) -> str:
    """What is said of runs whose history cannot be told any more, by their names."""
    verb = "run is" if len(runs) == 1 else "runs are"
    return f"{len(runs)} {verb} left out, of which only the successes were kept: {few(runs, NAMED)}."


def _overview(entries: Sequence[Entry]) -> str:
    runs = [run for entry in entries for run in entry.runs]
    going = [run for run in runs if not run.complete]
    said = [f"`{run.path.name}` ({run.evaluations:,} of {run.spec.evaluations:,})" for run in going]
    more = ", see `runs.csv`" if len(going) > NAMED else ""
    scenes, evaluations = {entry.scene for entry in entries}, sum(run.evaluations for run in runs)
    spent = counted(evaluations, "evaluation", told="{:,}".format)
    unfinished = f" {len(going)} unfinished: {few(said, NAMED)}{more}." if going else ""
    return f"{counted(len(runs), 'run')} on {counted(len(scenes), 'scene')}, {spent}.{unfinished}\n"


def _claims(claims: Sequence[Judged]) -> str:
    summary = markdown(
        ("", "claim", "verdict", "what agreeing means"),
        [(one.claim.letter, one.claim.words, _verdict(one), one.claim.criterion) for one in claims],
    )
    numbers = markdown(
        ("", "number", "value", f"{LEVEL:.0%} interval", "this number", "evaluations", "scenes", "runs"),
        [
            (
                one.claim.letter,
                f"`{found.subject}`: {found.statistic}",
                *_number(found.interval),
                verdict,
                *_behind(found),
            )
            for one in claims
            for found, verdict in _judged(one)
        ],
    )
    notes = (
        f"Intervals: hierarchical bootstrap, {RESAMPLES:,} resamples of scenes and of the runs in each. "
        "With one scene they speak of that scene alone. Methods are compared after as many evaluations, "
        "with finished runs only where there are any.\n\n"
        f"\\* Fewer than {FEW} runs: such an interval is narrower than it says, and its verdict is "
        "provisional; of two runs, it reaches from one to the other.\n"
    )
    return "\n".join([summary, numbers, notes])


def _verdict(one: Judged) -> str:
    lacking = (
        f" ({one.absent} of {len(one.claim.methods)} numbers not in this campaign)" if one.absent else ""
    )
    return f"**{one.verdict.value}**{MARK if one.is_of_few else ''}{lacking if one.findings else ''}"


def _judged(one: Judged) -> Iterable[tuple[Finding, str]]:
    for found in one.findings:
        yield found, one.claim.band.verdict(found.interval).value + (MARK if found.is_of_few else "")
    for found in one.beside:
        yield found, "to compare with"


def _number(found: Interval) -> tuple[str, str]:
    interval = f"{found.low:.3g} to {found.high:.3g}" if found.is_known else "none: one run"
    return f"{found.value:.3g}", interval


def _behind(found: Finding) -> tuple[str, str, str]:
    low, high = min(found.evaluations), max(found.evaluations)
    ends = f"{low:,}" if low == high else f"{low:,} to {high:,}"
    return ends, str(found.interval.scenes), " / ".join(map(str, found.interval.runs))


def _figure(name: str, missing: str) -> str:
    if missing:
        return f"## {name.capitalize()}\n\nNot drawn: {missing}.\n"
    return f"## {name.capitalize()}\n\n![{name}]({name}.png)\n\n{CAPTIONS[name]}\n"


def _scenes(entries: Sequence[Entry]) -> Iterable[str]:
    scenes: dict[SceneName, list[Entry]] = {}
    for entry in entries:
        scenes.setdefault(entry.scene, []).append(entry)
    for scene, here in scenes.items():
        yield f"### {scene.words}\n"
        yield _target_words(here[0])
        yield _methods(here)


def _target_words(entry: Entry) -> str:
    target = entry.target
    if not target.size:
        return f"No coverage: {target.why}.\n"
    mark = ", by a stand-in for the scan" if target.stand_in else ""
    return f"S_G has {target.size:,} entries{mark}.\n"


def _methods(entries: Sequence[Entry]) -> str:
    rows = method_rows(entries)
    shown = [name for name in FIGURES if any(row[name] is not None for row in rows)]
    body = [
        (entry.name, _runs(entry), COUNTED[entry.overlaps], *(_quartiles(row, name) for name in shown))
        for entry, row in zip(entries, rows, strict=True)
    ]
    return markdown(("method", "n", "counted", *(FIGURES[name][0] for name in shown)), body)


def _runs(entry: Entry) -> str:
    return f"{len(entry.runs)}{f', {entry.unfinished} unfinished' if entry.unfinished else ''}"


def _quartiles(row: Row, name: str) -> str:
    values: list[Any] = [row[name], row[f"{name}_q1"], row[f"{name}_q3"]]
    if values[0] is None:
        return ""
    median, low, high = map(FIGURES[name][1], values)
    return median if low == high == median else f"{median} [{low}, {high}]"


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
