"""What the default method covers, beside what it is to cover."""

from collections.abc import Iterator, Sequence

import numpy as np
from tests.benchmarks.results.arms import COUNTING, Arm
from tests.benchmarks.results.row import MILESTONES

from qdgrasp_coordinator.analysis.page import markdown

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
COLUMNS = (
    "hand", "object", "protocol", "counting", "budget", "runs",
    *(f"{milestone:,}" for milestone in MILESTONES), "end",
    "robust", "mean best fitness", "orientations", "aim", "code",
)  # fmt: skip


def coverage_part(known: Sequence[Arm]) -> str:
    """The section on coverage."""
    shown = [arm for arm in known if arm.is_default and arm.key.budget >= LEAST]
    return (
        "## Coverage of the default method\n\n"
        "Share of S_G in percent, de-duplicated, after so many counted evaluations: median over seeds, "
        "and in brackets their range. *Robust*: the share of S_G in whose cells a success of fitness 2 was "
        "found. *Mean best fitness*: the best fitness in a cell with a success, 0 to 2, mean over these "
        "cells. *Orientations*: of 60 bins, those with a success in such a cell, mean over these cells.\n\n"
        + markdown(COLUMNS, [_line(arm) for arm in shown])
        + "\n"
        + "\n".join(_short(shown))
    )


def _line(arm: Arm) -> tuple[str, ...]:
    return (
        arm.key.gripper, arm.key.object, arm.key.protocol, COUNTING[arm.key.overlaps],
        f"{arm.key.budget:,}", arm.count,
        *(arm.words(f"coverage_{milestone // 1000}k", 100) for milestone in MILESTONES),
        arm.words("coverage", 100),
        arm.words("robust_coverage", 100), arm.words("mean_best", 1, 2), arm.words("orientations", 1, 2),
        _aim(arm), arm.codes,
    )  # fmt: skip


def _aim(arm: Arm) -> str:
    """What is aimed at, and whether it is reached."""
    verdicts = []
    for evaluations, percent in _targets(arm).items():
        found = arm.values(f"coverage_{evaluations // 1000}k", 100)
        verdict = "" if not len(found) else (": met" if np.median(found) >= percent else ": **short**")
        verdicts.append(f"{percent:.0f} at {evaluations:,}{verdict}")
    return ", ".join(verdicts)


def _targets(arm: Arm) -> dict[int, float]:
    known = TARGETS.get((*arm.scene, arm.key.overlaps), {})
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
