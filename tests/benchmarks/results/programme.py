"""The programme: which runs the table of results is to have, as campaigns in `deploy/results`."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.results.row import Key, Row, key

from qdgrasp_coordinator.campaigns.campaign import Campaign, read_campaign
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec

HOME = Path(__file__).resolve().parents[3] / "deploy" / "results"


@dataclass(frozen=True)
class Wanted:
    """A run of the programme."""

    name: str
    """As its campaign calls it; runs that differ in their budget alone share it."""
    spec: RunSpec

    @property
    def key(self) -> Key:
        """The key of its row."""
        return key(self.spec)


@dataclass(frozen=True)
class Programme:
    """Runs by the campaign that asks for them; two may ask for the same one."""

    campaigns: Mapping[str, tuple[Wanted, ...]]

    @property
    def wanted(self) -> dict[Key, Wanted]:
        """Every run once, in the order of the campaigns."""
        return {one.key: one for runs in self.campaigns.values() for one in runs}

    def budgets(self, asked: Key) -> set[int]:
        """The budgets that the programme has for a run, whatever its own."""
        return {one.budget for one in self.wanted if one._replace(budget=asked.budget) == asked}

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
    return Programme({file.stem: _wanted(read_campaign(file, here=False)) for file in files})


def chosen(known: Programme, names: Collection[str]) -> Programme:
    """A programme of some of its campaigns; of all where none is named.

    Raises
    ------
    InputError
        There is no campaign of such a name.
    """
    if unknown := [name for name in names if name not in known.campaigns]:
        raise InputError(f"No campaign '{unknown[0]}' in the programme; known: {', '.join(known.campaigns)}.")
    return Programme({name: runs for name, runs in known.campaigns.items() if not names or name in names})


def _wanted(asked: Campaign) -> tuple[Wanted, ...]:
    return tuple(Wanted(name, spec) for name, spec in asked.runs.items())


def evaluations(runs: Iterable[Wanted]) -> int:
    """The budgets of runs, summed."""
    return sum(one.spec.evaluations for one in runs)
