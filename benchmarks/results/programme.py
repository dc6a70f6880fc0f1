"""The runs that the table of results is to have, and the order in which missing ones are done."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from statistics import median

from benchmarks.results import assets
from benchmarks.results.table import Key, Row, key
from msgspec import structs

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.campaign_file import Campaign, read_campaign

HOME = Path(__file__).resolve().parents[2] / "deploy" / "results"


BENCHMARK = assets.NAME
"""The text with which the names of the benchmark's campaigns begin."""
SWEEP = f"{BENCHMARK}-sweep"
"""The campaign that chooses the settings of its baselines."""
TUNING_HAND, TUNING = "panda", ("ycb_rubiks_cube", "ycb_mug", "ycb_power_drill")
"""The hand and objects on which constants of searches are chosen; all other scenes are held out."""


@dataclass(frozen=True)
class Wanted:
    """A run of the programme."""

    name: str
    """Its name in the campaign; runs that differ in their budget alone share it."""
    spec: RunSpec

    @cached_property
    def key(self) -> Key:
        """The key of its row."""
        return key(self.spec)


@dataclass(frozen=True)
class Programme:
    """Runs by the campaign that asks for them; two may ask for the same one."""

    campaigns: Mapping[str, tuple[Wanted, ...]]

    def part(self, prefix: str, without: tuple[str, ...] = ()) -> "Programme":
        """The campaigns whose names begin with one text, and with none of some others."""
        campaigns = self.campaigns.items()
        return Programme(
            {
                name: runs
                for name, runs in campaigns
                if name.startswith(prefix) and not name.startswith(without)
            }
        )

    @property
    def benchmark(self) -> "Programme":
        """The benchmark's campaigns of methods; its sweep has a section of its own."""
        return self.part(BENCHMARK, without=(SWEEP,))

    @cached_property
    def wanted(self) -> dict[Key, Wanted]:
        """Every run once, in the order of the campaigns."""
        return {one.key: one for runs in self.campaigns.values() for one in runs}

    def budgets(self, asked: Key) -> set[int]:
        """All budgets that the programme has for the run of a key."""
        return self._budgets.get(asked._replace(budget=0), set())

    @cached_property
    def _budgets(self) -> dict[Key, set[int]]:
        """Budgets by the keys of runs, without their own."""
        found: dict[Key, set[int]] = {}
        for one in self.wanted:
            found.setdefault(one._replace(budget=0), set()).add(one.budget)
        return found

    def missing(self, table: Mapping[Key, Row], current: Collection[str]) -> list[Wanted]:
        """The runs without a row of the evaluation code that counts as today's."""
        return [
            one
            for asked, one in self.wanted.items()
            if asked not in table or table[asked].code not in current
        ]


def programme(home: Path = HOME) -> Programme:
    """The programme in a folder of campaigns; their hands and objects need not be on this machine.

    Raises
    ------
    InputError
        There is no campaign, or one of them cannot be.
    """
    files = sorted(home.glob("*.toml"))
    if not files:
        raise InputError(f"{home} holds no campaigns; the programme of results is made of some.")
    return Programme({file.stem: _wanted(read_campaign(file, here=False, is_begun=True)) for file in files})


def chosen(known: Programme, names: Collection[str], cells: Collection[str] = ()) -> Programme:
    """A programme of some of its campaigns, and of the runs with one of these texts in their name.

    Where no campaign is named it is of all, and where there is no text of all runs.

    Raises
    ------
    InputError
        There is no campaign of such a name, or no run.
    """
    if unknown := [name for name in names if name not in known.campaigns]:
        raise InputError(f"No campaign '{unknown[0]}' in the programme; known: {', '.join(known.campaigns)}.")
    campaigns = {name: runs for name, runs in known.campaigns.items() if not names or name in names}
    runs = [one.name for some in campaigns.values() for one in some]
    if absent := [text for text in cells if not any(text in name for name in runs)]:
        raise InputError(f"No run has '{absent[0]}' in its name; they are called as '{runs[0]}'.")
    return Programme(
        {
            name: tuple(one for one in some if not cells or any(text in one.name for text in cells))
            for name, some in campaigns.items()
        }
    )


def located(known: Programme, home: Path) -> Programme:
    """A programme with the files of the benchmark's own hands and objects in their folder below `home`."""
    return Programme(
        {name: tuple(map(partial(_located, home), runs)) for name, runs in known.campaigns.items()}
    )


def _located(home: Path, one: Wanted) -> Wanted:
    places = {key: assets.located(getattr(one.spec, key), home) for key in ("gripper", "object")}
    return replace(one, spec=structs.replace(one.spec, **places))


def _wanted(asked: Campaign) -> tuple[Wanted, ...]:
    return tuple(Wanted(name, spec) for name, spec in asked.runs.items())


def evaluations(runs: Iterable[Wanted]) -> int:
    """The budgets of runs, summed."""
    return sum(one.spec.evaluations for one in runs)


STAGE = 600.0
"""CPU seconds of a stage [s]: after each one the table is written."""
HAND_MS = {
    "panda": 10.0, "robotiq": 10.0, "xarm": 30.0, "pr2": 30.0, "allegro": 30.0, "shadow": 25.0,
    "barrett": 60.0, "bh280": 80.0,
}  # fmt: skip
"""Assumed cost of an evaluation [ms] by a part of the hand's name, while no run is known."""
UNKNOWN_MS = 50.0
LIKENESS: tuple[Callable[[Key], tuple[str, ...]], ...] = (
    lambda one: (one.gripper, one.protocol, one.overlaps, one.method, one.object),
    lambda one: (one.gripper, one.protocol, one.overlaps, one.method),
    lambda one: (one.gripper, one.protocol, one.overlaps),
)
"""Values that runs of similar cost share, the most similar first."""


class Costs:
    """Costs of runs, estimated from those in the table."""

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
    """Runs scene by scene, the cheapest scene first; in a scene the cheapest run, then the first seeds."""
    seconds = {one.key: costs.seconds(one.key) for one in runs}
    scenes: dict[tuple[str, str, str], float] = {}
    for run, cost in seconds.items():
        scenes[run.scene] = scenes.get(run.scene, 0.0) + cost

    def place(one: Wanted) -> tuple[object, ...]:
        run = one.key
        return scenes[run.scene], run.scene, seconds[run], run.seed, run

    return sorted(runs, key=place)


def stages(runs: Sequence[Wanted], costs: Costs) -> Iterator[list[Wanted]]:
    """Split the runs into parts for a campaign: some ten minutes of CPU, no name twice."""
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
