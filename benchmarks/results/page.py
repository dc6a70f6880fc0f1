"""The page of results, `docs/results/index.md`, made of the table and the reference sets beside it."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from benchmarks.results.benchmark import benchmark_part
from benchmarks.results.comparison import (
    ANY,
    COUNTING,
    ROBUST_CELLS,
    Arm,
    arms,
    comparison_part,
    settings_of,
    spread,
)
from benchmarks.results.paper_claims import CAMPAIGN as CLAIMS
from benchmarks.results.paper_claims import SIGMA_GRID, claims_part, sigma_part
from benchmarks.results.programme import BENCHMARK, SWEEP, TUNING, Programme
from benchmarks.results.reference_sets import SceneSet, sets_part
from benchmarks.results.table import MILESTONES, Key, Row
from numpy.typing import NDArray

from qdgrasp_tools.report.tables import markdown_table

LEAST = 10_000
"""The smallest budget that has a line [counted evaluations]."""
TARGETS = {
    ("ref_panda_2f", "ycb_rubiks_cube", "released", "redraw"): {5000: 50.0, 10_000: 85.0},
    ("ref_panda_2f", "ycb_mug", "released", "redraw"): {5000: 50.0, 10_000: 75.0},
    ("ref_allegro", "ycb_rubiks_cube", "released", "redraw"): {5000: 50.0, 10_000: 80.0},
    ("ref_panda_2f", "ycb_rubiks_cube", "released", "count"): {10_000: 35.0},
    ("ref_panda_2f", "ycb_mug", "released", "count"): {10_000: 55.0},
}
"""The median that is aimed at [%], after so many evaluations."""
SHOWN = {name: MILESTONES[name] for name in ("1k", "2k", "5k", "10k")}
"""Milestones that have a column."""
COVERAGE_COLUMNS = (
    "hand", "object", "protocol", "counting", "budget", "runs",
    *(f"{milestone:,}" for milestone in SHOWN.values()), "end",
    "outside", "robust", "mean best fitness", "orientations", "target", "code",
)  # fmt: skip


def coverage_part(known: Sequence[Arm]) -> str:
    """The section on coverage."""
    shown = [arm for arm in known if arm.is_default and arm.key.budget >= LEAST]
    return (
        "## Coverage of S_G by the search for touch\n\n"
        "`aimed` for touch, the default of version 0.1.0. "
        "Share of S_G in percent, de-duplicated, after so many counted evaluations: median over seeds, and "
        "in brackets their range. *Outside*: the share of a run's cells that are not in it. *Robust*: the "
        "share of S_G in whose cells a success of fitness 2 was found. *Mean best fitness*: the best fitness "
        "in a cell with a success, 0 to 2, mean over these cells. *Orientations*: of 60 bins, those with a "
        "success in such a cell, mean over these cells. *Target*: the median that this project set itself "
        "before these runs.\n\n"
        + markdown_table(COVERAGE_COLUMNS, [_coverage_line(arm) for arm in shown])
        + "\n"
        + "\n".join(_short(shown))
    )


def _coverage_line(arm: Arm) -> tuple[str, ...]:
    return (
        arm.key.gripper, arm.key.object, arm.key.protocol, COUNTING[arm.key.overlaps],
        f"{arm.key.budget:,}", arm.count,
        *(arm.words(f"coverage_{name}", 100) for name in SHOWN),
        arm.words("coverage", 100),
        arm.words("outside_share", 100), arm.words("robust_share", 100),
        arm.words("mean_best", 1, 2), arm.words("orientations", 1, 2),
        _aim(arm), arm.codes,
    )  # fmt: skip


def _aim(arm: Arm) -> str:
    """The targets [%] after so many evaluations, and whether they are reached."""
    verdicts = []
    for evaluations, percent in _targets(arm).items():
        found = arm.values(f"coverage_{evaluations // 1000}k", 100)
        verdict = "" if not len(found) else (": met" if np.median(found) >= percent else ": **short**")
        verdicts.append(f"{percent:.0f} at {evaluations:,}{verdict}")
    return ", ".join(verdicts)


def _targets(arm: Arm) -> dict[int, float]:
    known = TARGETS.get((*arm.key.scene, arm.key.overlaps), {})
    return known if arm.key.budget == LEAST else {}


def _short(shown: Sequence[Arm]) -> Iterator[str]:
    """A sentence for each aim that is missed, and one for the runs that are not in."""
    for arm in shown:
        for evaluations, percent in _targets(arm).items():
            found = arm.values(f"coverage_{evaluations // 1000}k", 100)
            if len(found) and (gap := percent - np.median(found)) > 0:
                where = f"{arm.key.gripper} on {arm.key.object}, {COUNTING[arm.key.overlaps]}"
                yield f"- {where}: {gap:.1f} points short of {percent:.0f} % at {evaluations:,}."
    lacking = sum(len(arm.seeds) - len(arm.rows) for arm in shown)
    if lacking:
        yield f"- {lacking} of the {sum(len(arm.seeds) for arm in shown)} runs are not in yet."
    yield ""


SCENE = ("panda", "ycb_rubiks_cube", "paper")
"""The scene that stands first."""
CPU_COLUMNS = (
    "hand", "object", "method", "counting", "evaluations", "runs", "coverage, %", "CPU s", "% of S_G a CPU s",
    "a success, ms", "ceiling, % a CPU s", "of the ceiling, %", "code",
)  # fmt: skip


def cpu_part(known: Sequence[Arm]) -> str:
    """The section on CPU time."""
    shown = [arm for arm in known if len(arm.values("coverage"))]
    order = sorted(shown, key=lambda arm: (arm.key.scene != SCENE, arm.key.scene, -_rate(arm)))
    return (
        "## Coverage for CPU time\n\n"
        "CPU seconds are those of the workers, shakes and screening included, on shared cores: take them as "
        "ratios. A run that goes on to twice as many evaluations covers less a second, and a method that has "
        "found little finds a new cell more easily: compare runs of equal evaluations or of equal coverage, "
        "of one *code*. "
        "*A success* is what a success costs, fitted to the blocks of each journal; "
        "at the *ceiling* every evaluation is a success in a new cell of S_G.\n\n"
        + markdown_table(CPU_COLUMNS, [_cpu_line(arm) for arm in order])
    )


def _rate(arm: Arm) -> float:
    return float(np.median(arm.values("coverage_per_cpu_second")))


def _cpu_line(arm: Arm) -> tuple[str, ...]:
    rates, ceilings = arm.values("coverage_per_cpu_second", 100), _ceilings(arm)
    return (
        arm.key.gripper, arm.key.object, arm.method, COUNTING[arm.key.overlaps],
        f"{arm.key.budget:,}", arm.count, arm.words("coverage", 100), arm.words("cpu_seconds", 1, 0),
        spread(rates, 3), arm.words("success_ms", 1, 1), spread(ceilings, 2),
        f"{100 * np.median(rates) / np.median(ceilings):.0f}" if len(ceilings) else "", arm.codes,
    )  # fmt: skip


def _ceilings(arm: Arm) -> NDArray[np.float64]:
    """Percent of S_G a CPU second, were every evaluation a success in a new cell of it (n,)."""
    known = [(row.set_size, row.success_ms) for row in arm.rows.values()]
    return np.array([100 / (size * cost / 1000) for size, cost in known if size and cost])


SWEEP_COLUMNS = ("method", "population", "sigma", "runs", *TUNING, "share of the best")


def sweep_part(known: Sequence[Arm]) -> str:
    """The section on the settings of the baselines; empty while a run of the sweep is missing."""
    if not known or not all(arm.is_complete for arm in known):
        return ""
    groups: dict[tuple[str, int, str], dict[str, Arm]] = {}
    for arm in known:
        groups.setdefault(_setting(arm), {})[arm.key.object] = arm
    best = {scene: max(_held(group[scene]) for group in groups.values()) for scene in TUNING}
    shares = {
        setting: float(np.mean([_held(group[scene]) / best[scene] for scene in TUNING]))
        for setting, group in groups.items()
    }
    return (
        "## Settings of the baselines\n\n"
        "Cells that hold, Panda on the tuning scenes, after as many evaluations: median over seeds, and in "
        "brackets their range. *Share of the best*: the median over that of the best line on the same "
        "scene, mean over scenes; the best setting of each method stands out.\n\n"
        + markdown_table(
            SWEEP_COLUMNS, [_sweep_line(setting, groups[setting], shares) for setting in sorted(groups)]
        )
    )


def _sweep_line(
    setting: tuple[str, int, str], group: Mapping[str, Arm], shares: Mapping[tuple[str, int, str], float]
) -> tuple[str, ...]:
    method, population, sigma = setting
    share = f"{shares[setting]:.0%}"
    is_best = shares[setting] == max(share for (name, *_), share in shares.items() if name == method)
    return (
        f"`{method}`", str(population), sigma, str(sum(len(arm.rows) for arm in group.values())),
        *(group[scene].words(ROBUST_CELLS.name, digits=0) for scene in TUNING),
        f"**{share}**" if is_best else share,
    )  # fmt: skip


def _held(arm: Arm) -> float:
    return float(np.median(arm.values(ROBUST_CELLS.name)))


def _setting(arm: Arm) -> tuple[str, int, str]:
    """Method, population, and sigma where the method mutates."""
    said = settings_of(arm.key)
    sigma = (
        "" if arm.key.method.endswith("cma_mae") else said.get("mutation_sigma", f"{ANY.mutation_sigma:g}")
    )
    return arm.key.method, int(said.get("population", ANY.population)), sigma


INTRODUCTION = """# Results

Made by `make results-page` from [runs.csv](runs.csv), which has a line for each finished run
([its columns](../results.md#the-table-of-runs); [as Parquet](runs.parquet)), and from the
[reference sets](#reference-sets-of-our-own) beside it. The runs are those that the
campaigns in [deploy/results](../../deploy/results) ask for; `make results` carries out what is missing.
[How the results are made](methods.md): scenes, work, measures and statistics.

Other pages: [ranked grasps under unseen disturbances](calibration.md), in the place of the paper's table of
transfer to a robot, with no robot; [constants refitted without one tuning object](leave-one-out.md);
[the paper's Figures 1 to 4](../experiment.md#the-figures-from-the-runs-so-far). `aimed` is this project's
default search, and all other methods are the paper's.
"""


def page(known: Programme, table: Mapping[Key, Row], sets: Sequence[SceneSet] = ()) -> str:
    """The whole page."""
    benchmark = arms(known.benchmark, table)
    here, claimed = arms(known.part("", without=(BENCHMARK, CLAIMS, SIGMA_GRID)), table), known.part(CLAIMS)
    parts = [
        INTRODUCTION,
        benchmark_part(benchmark),
        comparison_part(benchmark, "## The benchmark, scene by scene"),
        sweep_part(arms(known.part(SWEEP), table)),
        claims_part(arms(claimed, table)),
        sigma_part(arms(known.part(SIGMA_GRID), table)),
        sets_part(sets, _scenes_with_runs((known.benchmark, claimed), table)),
        coverage_part(here),
        comparison_part(here, "## Successes: the search for touch against the others"),
        cpu_part(here),
        _standing(known, table),
    ]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def _scenes_with_runs(parts: Sequence[Programme], table: Mapping[Key, Row]) -> int:
    return len({one.scene for part in parts for one in part.wanted if one in table})


def _standing(known: Programme, table: Mapping[Key, Row]) -> str:
    """The number of finished runs, and their code."""
    wanted = known.wanted
    here = [table[one] for one in wanted if one in table]
    others = len(table) - len(here)
    besides = f" {others} more rows of the table are of runs that it does not ask for." if others else ""
    return (
        "## Which runs are in\n\n"
        f"{len(here)} of the {len(wanted)} runs of the programme are in.{besides}\n\n"
        + markdown_table(("campaign", "runs", "in", "missing"), list(_campaigns(known, table)))
        + "\n"
        + markdown_table(("evaluation code", "version", "rows"), list(_codes(here)))
    )


def _campaigns(known: Programme, table: Mapping[Key, Row]) -> Iterator[tuple[str, ...]]:
    for name, runs in known.campaigns.items():
        here = sum(one.key in table for one in runs)
        link = f"[{name}](../../deploy/results/{name}.toml)"
        yield link, str(len(runs)), str(here), str(len(runs) - here)


def _codes(here: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    for (code, version), rows in Counter((row.code, row.version) for row in here).most_common():
        yield f"`{code}`", version, str(rows)
