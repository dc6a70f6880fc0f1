"""What coverage costs, beside the authors' best and the ceiling."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from tests.benchmarks.results.arms import COUNTING, Arm, spread

from qdgrasp_coordinator.analysis.page import markdown

AUTHORS = 0.079
"""Percent of S_G a CPU second, the best of the authors' code: approach_rand, Panda on rubiks_cube, 10 000."""
SCENE, BUDGET = ("panda", "ycb_rubiks_cube", "paper"), 10_000
"""Where that is compared, and after how many evaluations."""
COLUMNS = (
    "hand", "object", "method", "counting", "evaluations", "runs", "coverage, %", "CPU s", "% of S_G a CPU s",
    f"x {AUTHORS}", "a success, ms", "ceiling, % a CPU s", "of the ceiling, %", "code",
)  # fmt: skip


def cpu_part(known: Sequence[Arm]) -> str:
    """The section on CPU time."""
    shown = [arm for arm in known if len(arm.values("coverage")) and (arm.is_default or arm.scene == SCENE)]
    order = sorted(shown, key=lambda arm: (arm.scene != SCENE, -_rate(arm)))
    return (
        "## Coverage for CPU time\n\n"
        "CPU seconds are those of the workers, shakes and screening included, on shared cores: take them as "
        "ratios. A run that goes on to twice as many evaluations covers less a second: compare equal ones, "
        "of one *code*. "
        f"The authors' best is {AUTHORS} % of S_G a CPU second (approach_rand, Panda and rubiks_cube, 10 000 "
        "evaluations, 62 CPU s). *A success* is what a success costs, fitted to the blocks of each journal; "
        "at the *ceiling* every evaluation is a success in a new cell of S_G.\n\n"
        + markdown(COLUMNS, [_line(arm) for arm in order])
    )


def _rate(arm: Arm) -> float:
    return float(np.median(arm.values("coverage_per_cpu_second")))


def _line(arm: Arm) -> tuple[str, ...]:
    rates, ceilings = arm.values("coverage_per_cpu_second", 100), _ceilings(arm)
    return (
        arm.key.gripper, arm.key.object, arm.method, COUNTING[arm.key.overlaps],
        f"{arm.key.budget:,}", arm.count, arm.words("coverage", 100), arm.words("cpu_seconds", 1, 0),
        spread(rates, 3), _beside_authors(arm),
        arm.words("success_ms", 1, 1), spread(ceilings, 2),
        f"{100 * np.median(rates) / np.median(ceilings):.0f}" if len(ceilings) else "", arm.codes,
    )  # fmt: skip


def _beside_authors(arm: Arm) -> str:
    """How many times the authors' rate; empty for runs that theirs is not like."""
    is_alike = (arm.scene, arm.key.budget) == (SCENE, BUDGET)
    return f"{100 * _rate(arm) / AUTHORS:.1f}" if is_alike else ""


def _ceilings(arm: Arm) -> NDArray[np.float64]:
    """Percent of S_G a CPU second, were every evaluation a success in a new cell of it (n,)."""
    known = [(row.set_size, row.success_ms) for row in arm.rows.values()]
    return np.array([100 / (size * cost / 1000) for size, cost in known if size and cost])
