"""Searches: ask and tell, and the table of methods.

A search is a fold over ordered tells: what it asks in a generation depends on the seed and on what it was
told, never on clocks, workers or the order of arrival (the pipeline orders). It knows genomes in [-1, 1],
rows and its space; the paper's methods take no notice of what the genes mean.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, NoReturn, Protocol

from qdgrasp_assets import genes
from qdgrasp_coordinator.searches import cma_mae, given
from qdgrasp_coordinator.searches.aimed import Aimed
from qdgrasp_coordinator.searches.map_elites import MapElites, select_successes, select_uniform
from qdgrasp_coordinator.searches.random import RandomSearch
from qdgrasp_coordinator.searches.space import Space
from qdgrasp_protocol.errors import ImpossibleValue, UnknownName
from qdgrasp_protocol.genome import GIVEN, Genomes
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


Build = Callable[[RunSpec, Space], Search]
"""Makes a search from a spec and the space of its genomes."""


Check = Callable[[RunSpec], None]
"""Raises an `InputError` where a spec asks what the search cannot do."""


@dataclass(frozen=True)
class Method:
    """One line of the table."""

    name: str
    prior: str
    """The prior that decodes its genomes."""
    build: Build
    check: Check
    overlaps: Overlaps
    """Whether overlaps count as evaluations unless the spec says otherwise."""
    population: int
    """Genomes in a generation unless the spec says otherwise."""
    summary: str
    generations_in_flight: int = 1
    """Generations asked before the first is told unless the spec says otherwise."""


@dataclass(frozen=True)
class Family:
    """Methods that search alike and differ in their prior."""

    name: str
    build: Build
    summary: str
    population: int = 500
    """The paper's mu = lambda."""
    check: Check = lambda _: None
    priors: tuple[str, ...] = ("contact", "approach", "antipodal", "spherical")

    def method(self, prior: str) -> Method:
        """The line of the table with one prior."""
        summary = f"{self.summary}, {PRIORS[prior].words} (Huber et al. 2024)."
        name = PRIORS[prior].prefix + self.name
        return Method(name, prior, self.build, self.check, "count", self.population, summary)


class Named(NamedTuple):
    """How a prior appears in the table."""

    prefix: str
    words: str


PRIORS = {
    "contact": Named("contact_", "any angle to the surface"),
    "approach": Named("approach_", "at most 45 deg from the surface's normal"),
    "antipodal": Named("antipodal_", "two fingers on opposite points"),
    "spherical": Named("", "without a prior"),
    genes.AIMED: Named("", "into a cell"),
}


def _random(spec: RunSpec, space: Space) -> Search:
    return RandomSearch(spec.seed, spec.population, space.genes)


def _me_rand(spec: RunSpec, space: Space) -> Search:
    return MapElites(spec, space.genes, space.box, select_uniform)


def _me_scs(spec: RunSpec, space: Space) -> Search:
    return MapElites(spec, space.genes, space.box, select_successes)


def _cma_mae(spec: RunSpec, space: Space) -> Search:
    return cma_mae.CmaMae(spec, space.genes, space.box)


FAMILIES = (
    Family("rand", _random, "Uniform genomes", priors=("contact", "approach", "antipodal")),
    Family("me_rand", _me_rand, "MAP-Elites, parents uniform over the archive"),
    Family("me_scs", _me_scs, "MAP-Elites, successful elites first"),
    Family(
        "cma_mae",
        _cma_mae,
        "CMA-MAE, 15 evolution strategies",
        population=cma_mae.POPULATION,
        check=cma_mae.check,
    ),
)
"""The methods that Huber et al. 2024, section IV, compares; those without a prefix have no prior."""
AIMED = Method(
    "aimed",
    genes.AIMED,
    Aimed,
    lambda _: None,
    "redraw",
    50,
    "The default, this project's own: empty cells beside successes, with a neighbour's grasp.",
    generations_in_flight=2,
)
PAPER = [family.method(prior) for family in FAMILIES for prior in family.priors]
METHODS = {entry.name: entry for entry in (AIMED, *PAPER)}
"""The first one is the default, as `RunSpec` has it."""


def _given(spec: RunSpec, space: Space) -> Search:
    return given.given(spec, space.genes)


SCORING = Method(GIVEN, GIVEN, _given, given.check, "count", 500, "The poses of the spec, each once.")
"""No search: what re-scores grasps; it is not offered among the methods."""


def _elsewhere(spec: RunSpec, *_space: Space) -> NoReturn:
    raise ImpossibleValue(
        "method",
        spec.method,
        "one of `qdgrasp methods`: this is a search that a program of its own carries out, and goes on with "
        "(`qdgrasp.optimise` with resume=True)",
    )


CUSTOM = {
    prior: Method(f"custom_{prior}", prior, _elsewhere, _elsewhere, "count", 500, "A program's own search.")
    for prior in PRIORS
}
"""What stands in the spec of a run whose search came from outside, by prior: its folder is read like any."""


def method(name: str) -> Method:
    """The method of a name.

    Raises
    ------
    UnknownName
        No method is called so; the known ones are named.
    """
    known = METHODS | {other.name: other for other in (SCORING, *CUSTOM.values())}
    if name not in known:
        raise UnknownName("method", name, METHODS)
    return known[name]


def check(spec: RunSpec) -> None:
    """Check that a spec asks what its method can do.

    Raises
    ------
    UnknownName
        There is no such method.
    ImpossibleValue
        It does not.
    """
    chosen = method(spec.method)
    if spec.poses is not None and chosen is not SCORING:
        raise ImpossibleValue("poses", f"{len(spec.poses)} of them", f"left out for method '{spec.method}'")
    chosen.check(spec)
