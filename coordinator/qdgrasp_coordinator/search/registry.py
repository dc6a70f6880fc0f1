"""The table of search methods: the paper's, the default, and the one that re-scores poses.

A search is a fold over ordered tells: its genomes of a generation depend on the seed and on the rows told,
never on clocks, workers or the order of arrival (the pipeline orders). It knows genomes in [-1, 1], rows and
its space; the paper's methods ignore the meaning of genes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from qdgrasp_coordinator.search import fixed_poses
from qdgrasp_coordinator.search.base import SearchAlgorithm, SearchSpace
from qdgrasp_coordinator.search.paper_searches import (
    CMA_POPULATION,
    CmaMae,
    DominatedArchive,
    MapElites,
    RandomSearch,
    check_cma,
    select_successes,
    select_uniform,
)
from qdgrasp_coordinator.search.portfolio import CellSampling, Portfolio
from qdgrasp_protocol.errors import ImpossibleValue, UnknownName
from qdgrasp_protocol.rows import GIVEN
from qdgrasp_protocol.spec import OWN_SEARCH, AimFor, Overlaps, RunSpec

BuildSearch = Callable[[RunSpec, SearchSpace], SearchAlgorithm]
"""Makes a search from a spec and the space of its genomes."""
CheckSpec = Callable[[RunSpec], None]  # Raises an `InputError` where the search cannot carry out a spec


@dataclass(frozen=True)
class Method:
    """A method in the table: a search and its prior by a name, with defaults."""

    name: str
    prior: str
    """The prior that decodes its genomes."""
    build: BuildSearch
    check: CheckSpec
    overlaps: Overlaps
    """Counting of overlaps as evaluations unless the spec says otherwise."""
    population: int
    """Genomes in a generation unless the spec says otherwise."""
    summary: str
    generations_in_flight: int = 1
    """Generations asked before the first is told unless the spec says otherwise."""
    in_flight: int | None = None
    """Most genomes in flight of a search that redraws overlaps, unless the spec says how many."""
    aim_for: AimFor | None = None
    """Objective unless the spec says otherwise; None: the method has none."""


# Prefix and description of each prior in the table of methods.
PRIORS = {
    "contact": ("contact_", "any angle to the surface"),
    "approach": ("approach_", "at most 45 deg from the surface's normal"),
    "antipodal": ("antipodal_", "two fingers on opposite points"),
    "spherical": ("", "without a prior"),
    GIVEN: ("", "the pose itself"),
}


def _family(
    name: str,
    build: BuildSearch,
    words: str,
    population: int = 500,
    check: CheckSpec = lambda _: None,
    priors: tuple[str, ...] = ("contact", "approach", "antipodal", "spherical"),
) -> list[Method]:
    """Return the methods of one search, one for each prior; 500 is the paper's mu = lambda."""
    known = [(prior, *PRIORS[prior]) for prior in priors]
    return [
        Method(prefix + name, prior, build, check, "count", population, f"{words}, {by} (Huber et al. 2024).")
        for prior, prefix, by in known
    ]


PAPER = [
    *_family(
        "rand",
        lambda spec, space: RandomSearch(spec.seed, spec.population, space.genes),
        "Uniform genomes",
        priors=("contact", "approach", "antipodal"),
    ),
    *_family(
        "me_rand",
        lambda spec, space: MapElites(spec, space.genes, space.box, select_uniform),
        "MAP-Elites, parents uniform over the archive",
    ),
    *_family(
        "me_scs",
        lambda spec, space: MapElites(spec, space.genes, space.box, select_successes),
        "MAP-Elites, successful elites first",
    ),
    *_family(
        "me_dns",
        lambda spec, space: MapElites(spec, space.genes, space.box, select_uniform, DominatedArchive),
        "Dominated novelty search, 1000 elites",
        priors=("approach", "antipodal"),
    ),
    *_family(
        "cma_mae",
        lambda spec, space: CmaMae(spec, space.genes, space.box),
        "CMA-MAE, 15 evolution strategies",
        population=CMA_POPULATION,
        check=check_cma,
    ),
]
"""The methods that Huber et al. 2024, section IV, compare; those without prefix: no prior."""
PORTFOLIO = Method(
    "portfolio",
    GIVEN,
    Portfolio,
    lambda _: None,
    "redraw",
    50,
    "The default, this project's own: surface draws, turned grasps and neighbours, by what each earns.",
    generations_in_flight=2,
    in_flight=1200,
    aim_for="hold",
)
ANTIPODAL_CELLS = Method(
    "antipodal_cells",
    GIVEN,
    CellSampling,
    lambda _: None,
    "redraw",
    50,
    "Two fingers on opposite points, each cell until a grasp holds there, two tries at most.",
    aim_for="hold",
)
METHODS = {entry.name: entry for entry in (PORTFOLIO, ANTIPODAL_CELLS, *PAPER)}
"""The first one is the default, as `RunSpec` has it."""
SCORING = Method(
    GIVEN,
    GIVEN,
    lambda spec, space: fixed_poses.fixed_pose_search(spec, space.genes),
    fixed_poses.check_poses,
    "count",
    500,
    "The poses of the spec, each once.",
)
"""Method that scores given poses again; it is not offered among the methods."""


def _elsewhere(spec: RunSpec, *_space: SearchSpace) -> NoReturn:
    raise ImpossibleValue(
        "method",
        spec.method,
        "one of `qdgrasp methods`: this is a search that a program of its own carries out, and goes on with "
        "(`qdgrasp.optimise` with resume=True)",
    )


CUSTOM = {
    prior: Method(
        f"{OWN_SEARCH}{prior}", prior, _elsewhere, _elsewhere, "count", 500, "A program's own search."
    )
    for prior in PRIORS
}
"""Methods of runs whose search came from outside, by prior; their folders read like any."""


def method(name: str) -> Method:
    """Return the method of a name, or raise `UnknownName`, which names the known ones."""
    known = METHODS | {other.name: other for other in (SCORING, *CUSTOM.values())}
    if name not in known:
        raise UnknownName("method", name, METHODS)
    return known[name]


def prior_of(spec: RunSpec) -> str:
    """Return the prior of a spec's genomes."""
    return method(spec.method).prior


def check_spec(spec: RunSpec) -> None:
    """Check that a spec's method exists, and can carry out the spec."""
    chosen = method(spec.method)
    if spec.aim_for is not None and chosen.aim_for is None:
        raise ImpossibleValue("aim_for", spec.aim_for, f"left out for method '{spec.method}', which has none")
    if spec.diversity is not None and chosen is not PORTFOLIO:
        expected = f"left out for method '{spec.method}', which looks for no kinds"
        raise ImpossibleValue("diversity", spec.diversity, expected)
    if spec.poses is not None and chosen is not SCORING:
        raise ImpossibleValue("poses", f"{len(spec.poses)} of them", f"left out for method '{spec.method}'")
    if spec.in_flight is not None and spec.in_flight < spec.population:
        expected = f"at least one generation, which are {spec.population} genomes"
        raise ImpossibleValue("in_flight", spec.in_flight, expected)
    chosen.check(spec)
