"""How much a search finds in few evaluations, and in the CPU time that they take: each seed a run by itself.

The default method, counting both ways, beside the paper's best and its plainest. Evaluations and the search's
own time are counted; the reference set, where it is at hand, is the paper's.
"""

from statistics import median
from typing import Any

from tests.benchmarks import alone
from tests.benchmarks.measure import Figure

from qdgrasp_assets.catalog import object_names
from qdgrasp_coordinator.runs.preparation import full_spec
from qdgrasp_protocol.spec import DEFAULT_METHOD

EVALUATIONS = 1000
SEEDS = (0, 1)
HAND, SCANNED, STAND_IN = "panda", "ycb_rubiks_cube", "rubiks_cube"
ARMS: dict[str, dict[str, Any]] = {
    DEFAULT_METHOD: {"method": DEFAULT_METHOD},
    f"{DEFAULT_METHOD}, overlaps counted": {"method": DEFAULT_METHOD, "overlaps": "count"},
    "contact_me_scs": {"method": "contact_me_scs"},
    "antipodal_rand": {"method": "antipodal_rand"},
}


def measure(seconds: float) -> list[Figure]:
    """The lines of `make bench`; `seconds` plays no role: they take what the evaluations take."""
    thing = SCANNED if SCANNED in object_names() else STAND_IN
    found: dict[str, list[alone.Alone]] = {name: [] for name in ARMS}
    for seed in SEEDS:
        for name, arm in ARMS.items():
            values = {"gripper": HAND, "object": thing, "evaluations": EVALUATIONS, "seed": seed}
            found[name].append(alone.run(full_spec(values | arm)))
    return [_figure(f"{HAND} on {thing}, {name}", runs) for name, runs in found.items()]


def _figure(name: str, runs: list[alone.Alone]) -> Figure:
    cells = [int(run.finds.cells().after([EVALUATIONS])[-1]) for run in runs]
    seconds = [run.evaluation_seconds + run.search_seconds for run in runs]
    covered = [100 * float(run.coverage([EVALUATIONS])[-1]) for run in runs]
    rates = [share / taken for share, taken in zip(covered, seconds, strict=True)]
    remark = f"cells; {_range(cells, 'd')} in {EVALUATIONS:,} evaluations and {median(seconds):.1f} s"
    if covered[0] == covered[0]:
        remark += f"; {_range(covered, '.2f')} % of S_G, {_range(rates, '.3f')} % a second"
    each = tuple(count / taken for count, taken in zip(cells, seconds, strict=True))
    return Figure(name, sum(cells), sum(seconds), "cpu", remark, each)


def _range(values: list[Any], form: str) -> str:
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f"{low} to {high}"
