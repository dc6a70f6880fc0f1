"""Arms: runs that differ in their seed alone, and what they found."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tests.benchmarks.results.programme import Programme
from tests.benchmarks.results.row import Key, Row

from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.spec import RunSpec

ANY = RunSpec(gripper="any", object="any")
DEFAULT = ANY.method
"""The method of a run that names none."""
CODE = 6
"""Digits of a digest that tell it from others on a page."""
COUNTING = {"count": "every pose counted", "redraw": "overlaps redrawn"}


@dataclass(frozen=True)
class Arm:
    """Runs of the programme with one spec but for the seed."""

    key: Key
    """Of any of them; the seed means nothing."""
    seeds: tuple[int, ...]
    """Those that are wanted."""
    rows: Mapping[int, Row]
    """Those that are in the table, by seed."""

    @property
    def scene(self) -> tuple[str, str, str]:
        """Hand, object and protocol."""
        return self.key.gripper, self.key.object, self.key.protocol

    @property
    def method(self) -> str:
        """The method, with those of its settings that are not as it has them."""
        return f"`{self.key.method}`" + (f" ({', '.join(changes)})" if (changes := changed(self.key)) else "")

    @property
    def is_default(self) -> bool:
        """Whether its method is the default one, with its own settings."""
        return self.key.method == DEFAULT and not changed(self.key)

    @property
    def count(self) -> str:
        """How many of its runs are in, in words."""
        whole, here = len(self.seeds), len(self.rows)
        return str(whole) if here == whole else f"{here} of {whole}"

    @property
    def codes(self) -> str:
        """Beginnings of the digests of its runs' evaluation code."""
        return ", ".join(f"`{code[:CODE]}`" for code in sorted({row.code for row in self.rows.values()}))

    def values(self, figure: str, scale: float = 1.0) -> NDArray[np.float64]:
        """A figure of each run that has it (n,), by seed."""
        found = [getattr(self.rows[seed], figure) for seed in sorted(self.rows)]
        return scale * np.array([value for value in found if value is not None], dtype=np.float64)

    def words(self, figure: str, scale: float = 1.0, digits: int = 1) -> str:
        """The median of a figure, and in brackets its range where there are several runs."""
        return spread(self.values(figure, scale), digits)


def arms(known: Programme, table: Mapping[Key, Row]) -> list[Arm]:
    """The arms of a programme, by hand, object, protocol and method."""
    groups: dict[Key, list[Key]] = {}
    for asked in sorted(known.wanted):
        groups.setdefault(asked._replace(seed=0), []).append(asked)
    return [
        Arm(arm, tuple(one.seed for one in runs), {one.seed: table[one] for one in runs if one in table})
        for arm, runs in groups.items()
    ]


def changed(key: Key) -> list[str]:
    """The settings of a run that are not those of a campaign's run of its method."""
    said = {f"population={ANY.population}"} if "population=" not in key.settings else set()
    return sorted({*said, *key.settings.split()} - {f"population={method(key.method).population}"})


def spread(values: NDArray[np.float64], digits: int = 1) -> str:
    """The median of some numbers, and in brackets their range where there are several."""
    if not len(values):
        return ""
    low, middle, high = (f"{value:.{digits}f}" for value in (values.min(), np.median(values), values.max()))
    return middle if len(values) == 1 else f"{middle} ({low} to {high})"
