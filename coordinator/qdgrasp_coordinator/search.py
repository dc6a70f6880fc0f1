"""Searches: ask and tell, and the table of methods.

A search is a fold over ordered tells: what it asks in a generation depends on the seed and on what it was
told, never on clocks, workers or the order of arrival (the pipeline orders). It knows genomes in [-1, 1]
and rows; it does not know what the genes mean.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from qdgrasp_coordinator.archive import Box
from qdgrasp_coordinator.searches.map_elites import MapElites, select_successes, select_uniform
from qdgrasp_coordinator.searches.random import RandomSearch
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec


class Search(Protocol):
    """What every search does."""

    def ask(self, generation: int) -> Genomes:
        """The genomes of a generation: (lambda, d), float32; no rows when there is nothing left to ask.

        Called once per generation, in order.
        """

    def tell(self, generation: int, rows: Rows) -> None:
        """Hear what a whole generation found: its nominal rows, by index.

        Called once per generation, in order.
        """


Build = Callable[[RunSpec, int, Box], Search]
"""Makes a search from a spec, the number of genes, and the box of hand positions."""


@dataclass(frozen=True)
class Method:
    """One line of the table."""

    name: str
    prior: str
    """The prior that decodes its genomes."""
    build: Build
    overlaps: Overlaps
    """Whether overlaps count as evaluations unless the spec says otherwise."""
    summary: str


def _random(spec: RunSpec, genes: int, box: Box) -> Search:  # noqa: ARG001 - one signature for all
    return RandomSearch(spec.seed, spec.population, genes)


def _me_rand(spec: RunSpec, genes: int, box: Box) -> Search:
    return MapElites(spec, genes, box, select_uniform)


def _me_scs(spec: RunSpec, genes: int, box: Box) -> Search:
    return MapElites(spec, genes, box, select_successes)


_TABLE = (
    Method(
        "contact_rand",
        "contact",
        _random,
        "count",
        "Uniform genomes, any angle to the surface (Huber et al. 2024, section IV).",
    ),
    Method(
        "approach_rand",
        "approach",
        _random,
        "count",
        "Uniform genomes, at most 45 deg from the normal (Huber et al. 2024, section IV).",
    ),
    Method(
        "contact_me_rand",
        "contact",
        _me_rand,
        "count",
        "MAP-Elites, parents uniform over the archive (Huber et al. 2024, section III-C).",
    ),
    Method(
        "contact_me_scs",
        "contact",
        _me_scs,
        "count",
        "MAP-Elites, successful elites first (Huber et al. 2024, section III-C; Huber et al. 2023).",
    ),
    Method(
        "approach_me_scs",
        "approach",
        _me_scs,
        "count",
        "MAP-Elites, successful elites first, at most 45 deg from the normal (Huber et al. 2024).",
    ),
)
METHODS = {entry.name: entry for entry in _TABLE}


def method(name: str) -> Method:
    """The method of a name.

    Raises
    ------
    UnknownName
        No method is called so; the known ones are named.
    """
    if name not in METHODS:
        raise UnknownName("method", name, METHODS)
    return METHODS[name]
