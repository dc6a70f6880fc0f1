"""The plan: missing runs in the order of what they will cost, in stages."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from statistics import median

from tests.benchmarks.results.programme import Wanted
from tests.benchmarks.results.row import Key, Row

STAGE = 600.0
"""CPU seconds of a stage [s]: after each one the table is written."""
HAND_MS = {"panda": 10.0, "robotiq": 10.0, "allegro": 30.0, "shadow": 25.0, "barrett": 60.0, "bh280": 80.0}
"""What an evaluation is taken to cost [ms] with a hand whose name holds this, before any run has told."""
UNKNOWN_MS = 50.0
LIKENESS: tuple[Callable[[Key], tuple[str, ...]], ...] = (
    lambda one: (one.gripper, one.object, one.method, one.overlaps),
    lambda one: (one.gripper, one.method, one.overlaps),
    lambda one: (one.gripper, one.overlaps),
)
"""What makes two runs alike in cost, the closest first."""


class Costs:
    """What runs cost, judged by those that are in the table."""

    def __init__(self, rows: Iterable[Row]) -> None:
        known = [(row.key, row.cpu_seconds / row.evaluations) for row in rows if row.evaluations]
        self._known = [_grouped(known, alike) for alike in LIKENESS]

    def seconds(self, run: Key) -> float:
        """CPU seconds that a run will take."""
        for alike, known in zip(LIKENESS, self._known, strict=True):
            if alike(run) in known:
                return run.budget * median(known[alike(run)])
        named = [cost for hand, cost in HAND_MS.items() if hand in run.gripper]
        return run.budget * (named[0] if named else UNKNOWN_MS) / 1000


def _grouped(
    known: Sequence[tuple[Key, float]], alike: Callable[[Key], tuple[str, ...]]
) -> dict[tuple[str, ...], list[float]]:
    groups: dict[tuple[str, ...], list[float]] = {}
    for run, cost in known:
        groups.setdefault(alike(run), []).append(cost)
    return groups


def ordered(runs: Iterable[Wanted], costs: Costs) -> list[Wanted]:
    """Runs by what they will cost, cheapest first; of equally cheap ones each scene's first seeds."""
    return sorted(runs, key=lambda one: (costs.seconds(one.key), one.key.seed, one.key))


def stages(runs: Sequence[Wanted], costs: Costs) -> Iterator[list[Wanted]]:
    """The runs in parts that a campaign can have: about ten minutes of CPU time, and no name twice."""
    part: list[Wanted] = []
    spent = 0.0
    for one in runs:
        if part and (spent >= STAGE or one.name in {other.name for other in part}):
            yield part
            part, spent = [], 0.0
        part.append(one)
        spent += costs.seconds(one.key)
    if part:
        yield part
