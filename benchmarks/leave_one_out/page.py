"""The page `docs/results/leave-one-out.md`, made of the table and of nothing else."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from benchmarks.leave_one_out.grid import GRID, TODAY, VARIANTS, Values
from benchmarks.leave_one_out.refit import (
    MARGIN,
    Refit,
    Refits,
    Runs,
    compare,
    is_complete,
    mean_score,
    refits,
    robust_cells,
    scores,
)
from benchmarks.leave_one_out.runs import (
    HELD_OUT,
    HELD_OUT_SEEDS,
    TUNING_SEEDS,
    Key,
    Table,
    held_out_runs,
    tuning_runs,
)
from benchmarks.results.programme import TUNING

from qdgrasp_tools.report.tables import markdown_table

INTRODUCTION = f"""# Constants refitted without one object

The constants of the default search were chosen on three objects
([which, and on which](../methods.md#constants-of-the-default-search)). Does one of these objects decide too
much? {len(GRID)} constants are chosen anew here, from runs on all three objects and from runs on two of them.
Then today's constants and the refitted ones run on {len(HELD_OUT)} objects that had no part in either choice:
the other scans but the chips can.

```sh
python -m benchmarks.leave_one_out          # what is missing; can be stopped, goes on
python -m benchmarks.leave_one_out --page   # this page again, from leave-one-out.csv alone
```

Panda, protocol `physical` in MuJoCo, aiming for hold; the surface points have the seed of the run. What
counts is the number of cells with a grasp that holds at the end of a run.
[leave-one-out.csv](leave-one-out.csv) has a line for each run. *Code* is the digest of the code of evaluation
and search, constants included; a run of other code is done again, unless `--accept DIGEST` says that it gives
the same.
"""
CHOICE = f"""One constant at a time has another value, with {len(TUNING_SEEDS)} seeds. The *score* of a run is
its number of cells that hold, divided by the mean over all variants on that object.

**Rule**: of the values of a constant, the one with the best mean score over the objects in use is taken,
however small the difference is: so the choice depends on these objects as much as it can. A refitted set has
all values that replace today's, together; how constants act on one another is not looked at. By chance
two of three constants change, as today's is one of three numbers that are compared. *Standard error*: of the
difference of two variants, by the spread of seeds within a variant, pooled over all variants of an object;
*beyond it*: the constants whose new value is better by more than that. A rule that asks for more than one
standard error would change these alone.
"""
COMPARISON = f"""Each set of constants runs with {len(HELD_OUT_SEEDS)} seeds. Numbers are in percent of the
mean of today's constants on each object, so that each object weighs the same. *Difference*: mean of the
refitted constants less mean of today's, with the 95 % interval of a bootstrap over the runs on these objects
([how](../analysis.md#claims-and-their-intervals)). *Today's interval*: that of the mean of today's constants,
less 100 %. *Less*: the difference is smaller than the uncertainty of today's own mean; noisy runs make this
easier. *Equivalent*: the whole interval of the difference is within {MARGIN:.0%}; noisy runs make this
harder.
"""


def page(table: Table, evaluations: int) -> str:
    """The whole page, of the runs of this budget."""
    found, known = robust_cells(table, evaluations), refits(table, evaluations)
    parts = [
        INTRODUCTION,
        _standing(table, known, evaluations),
        f"## Each constant varied\n\n{CHOICE}\n{_constants()}\n{_scores(found)}",
        f"## Refitted constants\n\n{_refitted(known)}",
        f"## On other objects\n\n{COMPARISON}\n" + "\n".join(_held_out(found, known)),
    ]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _standing(table: Table, known: Refits, evaluations: int) -> str:
    """The number of finished runs, and their code."""
    rows = [row for key, row in table.items() if key.evaluations == evaluations]
    codes = sorted(Counter(row.code for row in rows).items())
    words = ", ".join(f"`{code}` of {number} runs" for code, number in codes) or "no run is in"
    hours = sum(row.cpu_seconds for row in rows) / 3600
    asked = {
        "tuning": tuning_runs(evaluations),
        "held out": held_out_runs([one.variant for one in known.values()], evaluations),
    }
    more = "" if known else "The refitted sets are known, and asked for, once all tuning runs are in.\n"
    return (
        f"{evaluations:,} evaluations a run, {hours:.1f} CPU hours in all. Code: {words}.\n\n"
        + markdown_table(("objects", "runs", "in"), [(name, *_counts(table, asked[name])) for name in asked])
        + f"\n{more}"
    )


def _counts(table: Table, asked: Sequence[Key]) -> tuple[str, str]:
    return str(len(asked)), str(sum(key in table for key in asked))


def _constants() -> str:
    """The table of the constants that are varied."""
    lines = [(f"`{one.name}`", one.words, _number(one.today)) for one in GRID.values()]
    return markdown_table(("constant", "meaning", "today"), lines)


def _number(value: float) -> str:
    return f"{value:g}"


def _scores(found: Runs) -> str:
    """Cells that hold of each variant, and scores where all variants have a run."""
    known = {scene: each for scene in TUNING if (each := scores(found, scene))}

    def cell(name: str, scene: str) -> str:
        score = f" ({known[scene][name].mean():.3f})" if scene in known else ""
        return _spread(found, name, scene) + score

    def mean(name: str) -> str:
        return f"{mean_score(known, name):.3f}" if len(known) == len(TUNING) else ""

    lines = [(f"`{name}`", *(cell(name, scene) for scene in TUNING), mean(name)) for name in VARIANTS]
    return (
        "Cells that hold, mean ± standard deviation over seeds, with the mean score in brackets:\n\n"
        + markdown_table(("variant", *TUNING, "mean score"), lines)
    )


def _spread(found: Runs, name: str, scene: str) -> str:
    """Mean and standard deviation of some runs; the number itself where there is one."""
    values = found.get((name, scene), np.zeros(0))
    if not len(values):
        return ""
    return f"{values.mean():.0f}" + (f" ± {values.std(ddof=1):.0f}" if len(values) > 1 else "")


def _refitted(known: Refits) -> str:
    if not known:
        return "Not all tuning runs are in.\n"

    def cell(name: str, values: Values) -> str:
        return f"**{_number(values[name])}**" if name in values else _number(GRID[name].today)

    lines = [
        (
            _chosen_on(left_out), *(cell(name, one.values) for name in GRID), f"{one.error:.4f}",
            ", ".join(f"`{name}`" for name in one.clear) or "none",
        )
        for left_out, one in known.items()
    ]  # fmt: skip
    today = ("today", *(_number(one.today) for one in GRID.values()), "", "")
    heads = ("chosen on", *(f"`{name}`" for name in GRID), "standard error", "beyond it")
    return "Values that replace today's are in bold.\n\n" + markdown_table(heads, [today, *lines])


def _chosen_on(left_out: str) -> str:
    return f"all but {left_out}" if left_out else "all three"


def _held_out(found: Runs, known: Refits) -> Iterator[str]:
    """The refitted sets compared with today's, and cells that hold by object."""
    if known:
        heads = (
            "chosen on", "constants", "difference, %", "95 % interval", "today's interval", "verdict",
            "equivalent",
        )  # fmt: skip
        yield markdown_table(heads, [_comparison(found, *each) for each in known.items()])
    arms = dict.fromkeys((TODAY, *(one.variant for one in known.values())))
    lines = [(scene, *(_spread(found, name, scene) for name in arms)) for scene in HELD_OUT]
    yield "Cells that hold, mean ± standard deviation over seeds:\n"
    yield markdown_table(("object", *(f"`{name}`" for name in arms)), lines)


def _comparison(found: Runs, left_out: str, one: Refit) -> tuple[str, ...]:
    line = (_chosen_on(left_out), f"`{one.variant}`")
    if one.variant == TODAY:
        return *line, "0", "", "", "less: the same constants", "yes"
    if not is_complete(found, one.variant):
        return *line, "", "", "", "not all runs are in", ""
    compared = compare(found, one.variant)
    return (
        *line,
        f"{100 * compared.difference.value:+.1f}",
        _interval(compared.difference.low, compared.difference.high),
        _interval(compared.today.low - 1.0, compared.today.high - 1.0),
        "less" if compared.is_within else "**not less**",
        "yes" if compared.is_equivalent else "**not shown**",
    )


def _interval(low: float, high: float) -> str:
    return f"{100 * low:+.1f} to {100 * high:+.1f}"
