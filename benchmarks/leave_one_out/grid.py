"""The constants that are varied, one at a time, and a search with other values of them."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from unittest import mock

from qdgrasp_protocol.errors import InputError

Values = Mapping[str, float]
"""Values of some constants by name; the others are as they are."""


@dataclass(frozen=True)
class Constant:
    """A constant of the default search."""

    name: str
    words: str
    """Meaning, for a reader."""
    today: float
    others: tuple[float, ...]
    """The values that are tried beside today's."""
    homes: tuple[str, ...]
    """The modules that define it, each with its name there; several if one idea stands in several places."""


SEARCH = "qdgrasp_coordinator.search"
GRID = {
    constant.name: constant
    for constant in (
        Constant(
            "TOUCH_VALUE", "value of touching alone", 0.2, (0.1, 0.4), ("qdgrasp_assets.genes.TOUCH_VALUE",)
        ),
        Constant(
            "WANTED", "value wanted of a candidate", 0.5, (0.3, 0.7), (f"{SEARCH}.value_search.WANTED",)
        ),
        Constant(
            "DEAD_END",
            "weight of a dead end, for cells and threshold",
            0.5,
            (0.25, 1.0),
            (f"{SEARCH}.frontier.DEAD_END", f"{SEARCH}.success_model.DEAD_END_DISCOUNT"),
        ),
        Constant(
            "EXPLORING_SHARE",
            "share of exploration",
            0.04,
            (0.02, 0.08),
            (f"{SEARCH}.aimed.EXPLORING_SHARE",),
        ),
        Constant(
            "MOST_CANDIDATES",
            "candidates of a genome",
            32,
            (16, 64),
            ("qdgrasp_assets.genes.MOST_CANDIDATES",),
        ),
        Constant(
            "POINT_SIGMA",
            "scatter of contact points [m]",
            0.007,
            (0.0035, 0.014),
            ("qdgrasp_worker.priors.aimed.POINT_SIGMA",),
        ),
        Constant(
            "FIT_INTERVAL",
            "examples between two fits",
            256,
            (128, 512),
            (f"{SEARCH}.success_model.FIT_INTERVAL",),
        ),
    )
}
"""Constants by name, as in docs/methods.md.

One process evaluates and searches, so that all can be replaced.
"""
TODAY = "today"
"""The variant whose constants are those of the code."""


def variant(values: Values) -> str:
    """The name of a search with these constants: `NAME=VALUE` of each that is another than today's."""
    changed = [
        f"{name}={values[name]:g}" for name in GRID if name in values and values[name] != GRID[name].today
    ]
    return " ".join(changed) or TODAY


def values_of(name: str) -> dict[str, float]:
    """The constants of a variant that are others than today's; the inverse of `variant`.

    Raises
    ------
    InputError
        A name or a value is not in the grid.
    """
    pairs = [each.partition("=")[::2] for each in name.split()] if name != TODAY else []
    known = {(one.name, f"{value:g}"): value for one in GRID.values() for value in one.others}
    if unknown := [pair for pair in pairs if pair not in known]:
        said = "=".join(unknown[0])
        raise InputError(f"'{said}' of the variant '{name}' is not in the grid: {', '.join(VARIANTS)}.")
    return {pair[0]: known[pair] for pair in pairs}


VARIANTS = (TODAY, *(variant({one.name: value}) for one in GRID.values() for value in one.others))
"""Today's constants, and each that is varied alone."""


@contextmanager
def patched(values: Values) -> Iterator[None]:
    """Replace constants in all modules that have them, until the end of the block."""
    with ExitStack() as patches:
        for name, value in values.items():
            for home in GRID[name].homes:
                for module in holders(home):
                    patches.enter_context(mock.patch.object(module, home.rpartition(".")[2], value))
        yield


def holders(home: str) -> list[ModuleType]:
    """The loaded modules of the package that have a constant under its name, its own among them."""
    module, _, name = home.rpartition(".")
    value = getattr(import_module(module), name)
    ours = [found for path, found in sys.modules.items() if path.startswith("qdgrasp")]
    return [found for found in ours if vars(found).get(name) is value]
