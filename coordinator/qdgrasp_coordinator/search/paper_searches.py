"""The searches of Huber et al. 2024 on pyribs' archive: random, MAP-Elites and CMA-MAE.

The archive is pyribs' grid, with one elite per 1 cm cell of positions. Its cells are those of `cells`,
aligned with S_G: edges at k + 0.5 cm in the object's CoM frame. Not repeated here are differences of the
paper's released code: a cube displaced by the object's inertial offset with bins of 1.00-1.02 cm, positions
outside it aliased into other cells, and a failure that replaces a failure with probability 0.5. Here
positions outside the box are left out, and ties keep the elder.

MAP-Elites is that of section III-B and appendix A, on Mouret and Clune 2015. As the paper states it: Gaussian
mutation of each gene with probability 0.3 and sigma 0.1, clipped to [-1, 1]. The released code mutates every
gene with sigma 0.05, and ignores successes until 500 cells hold one; see `select_successes`. In random search
every genome is a new draw. The released code re-evaluates the individuals of its first generation when it
does not count overlaps, and evaluates that generation twice in any case.

CMA-MAE is fifteen evolution strategies that improve their archive, with the parameters of Fontaine and
Nikolaidis 2023, "Covariance Matrix Adaptation MAP-Annealing": 15 emitters of 36, alpha 0.01, f_min -1;
sigma0 0.5 is that of the released code. The objective of a simulated pose is its fitness; a rejected one
(overlap, dead end, error, or a position outside the box) has f_min, so it is never inserted. Unlike in the
released code every emitter starts at a point of its own, a rejected pose is not worth as much as a miss, and
the genomes told are those asked. As there, genomes are clipped for evaluation alone.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, module_from_spec
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import PER_METRE, cells
from qdgrasp_coordinator.search.base import PositionBox, keyed_generator
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Genomes, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

if TYPE_CHECKING:
    from ribs.archives import GridArchive
    from ribs.emitters import EvolutionStrategyEmitter

FAILED = -1.0  # Objective of a valid pose that is no success: below any success's, which is its fitness


class CellBox:
    """The cells of a box of positions, enlarged to whole ones."""

    def __init__(self, box: PositionBox) -> None:
        self.low, self.high = cells(np.stack([np.asarray(corner) for corner in box]))

    def contains(self, places: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Flag the cells (n, 3) that are in the box: (n,)."""
        inside: NDArray[np.bool_] = ((places >= self.low) & (places <= self.high)).all(axis=1)
        return inside

    def archive(self, genes: int, unit: float = 1.0, **options: Any) -> "GridArchive":
        """Make a pyribs archive with a bin for each cell; measures are cells times `unit`."""
        # pyribs cuts a range into equal bins: from half a cell below the first middle to half above the last.
        ranges = list(zip((self.low - 0.5) * unit, (self.high + 0.5) * unit, strict=True))
        grid = grid_archive_type()
        return grid(solution_dim=genes, dims=self.high - self.low + 1, ranges=ranges, **options)


@cache
def grid_archive_type() -> "type[GridArchive]":
    """Return pyribs' GridArchive, without scikit-learn and numba.

    They take two seconds to load; other archives use the one, and faster sums by cell the other. So the
    packages around its module are not run, and sums are numpy's, with the same results. Who imports pyribs
    later gets the same class.
    """
    around = [name for name in ("numpy_groupies", "ribs", "ribs.archives") if name not in sys.modules]
    for name in around:
        sys.modules[name] = module_from_spec(cast(ModuleSpec, find_spec(name)))
    if "numpy_groupies" in around:
        sums = import_module("numpy_groupies.aggregate_numpy").aggregate
        vars(sys.modules["numpy_groupies"])["aggregate_nb"] = sums
    found: type[GridArchive] = import_module("ribs.archives._grid_archive").GridArchive
    for name in around:
        del sys.modules[name]
    return found


@dataclass(frozen=True)
class ArchiveElites:
    """Contents of an archive, in the order of its cells: the same archive gives the same order."""

    genomes: Genomes
    """(n, d)."""
    successful: NDArray[np.bool_]
    """(n,): True for successes."""

    def __len__(self) -> int:
        return len(self.genomes)


class EliteArchive:
    """The best genome found in each cell of a box of positions."""

    def __init__(self, genes: int, box: PositionBox) -> None:
        self._box = CellBox(box)
        self._grid = self._box.archive(genes, dtype=np.float32)

    def __len__(self) -> int:
        return len(self._grid)

    @property
    def elites(self) -> ArchiveElites:
        """All elites; pyribs holds them in the order in which their cells were reached first."""
        held = self._grid.data(["index", "solution", "objective"])
        order = np.argsort(held["index"])
        return ArchiveElites(held["solution"][order], held["objective"][order] > FAILED)

    def insert(self, rows: Rows) -> None:
        """Offer rows, elder ones first; overlaps, dead ends and errors are ignored."""
        valid = take_rows(rows, rows["outcome"] >= Outcome.MISSED)
        offered = take_rows(valid, self._box.contains(cells(valid["descriptor"][:, :3])))
        is_success = offered["outcome"] >= Outcome.DROPPED
        if len(offered):
            objectives = np.where(is_success, offered["fitness"], np.float32(FAILED))
            self._add(offered["genome"], objectives, offered["descriptor"][:, :3])

    def _add(self, genomes: Genomes, objectives: NDArray[np.float32], positions: ArrayLike) -> None:
        self._grid.add(genomes, objectives, cells(positions))


DNS_CAPACITY, DNS_NEIGHBOURS = 1000, 3


class DominatedArchive(EliteArchive):
    """Elites far from fitter ones: dominated novelty search (Bahlous-Boldi et al. 2025)."""

    def __init__(self, genes: int, box: PositionBox) -> None:
        from ribs.archives import DNSArchive

        self._box = CellBox(box)
        self._kept = DNSArchive(
            solution_dim=genes,
            measure_dim=3,
            capacity=DNS_CAPACITY,
            k_neighbors=DNS_NEIGHBOURS,
            dtype=np.float32,
        )

    @property
    def elites(self) -> ArchiveElites:
        """All elites, in the order of the archive."""
        held = self._kept.data(["solution", "objective"])
        return ArchiveElites(held["solution"], held["objective"] > FAILED)

    def _add(self, genomes: Genomes, objectives: NDArray[np.float32], positions: ArrayLike) -> None:
        self._kept.add(genomes, objectives, positions)


def ribs_archive(box: PositionBox, rows: Rows, objectives: NDArray[np.float64]) -> "GridArchive":
    """Return successes (n,) in a pyribs archive of the cells of a box, the best of each cell.

    Solutions are genomes, measures hand positions [m], CoM frame; bins are the 1 cm cells. Successes outside
    the box are left out: pyribs would clip them into border cells.
    """
    own = CellBox(box)
    archive = own.archive(rows["genome"].shape[1], 1.0 / PER_METRE)
    where = cells(rows["descriptor"][:, :3])
    inside = own.contains(where)
    if inside.any():
        archive.add(rows["genome"][inside], objectives[inside], where[inside] / PER_METRE)
    return archive


def uniform_genomes(seed: int, generation: int, n: int, genes: int) -> Genomes:
    """Genomes (n, genes) drawn from U(-1, 1)."""
    return keyed_generator(seed, "uniform", generation).uniform(-1.0, 1.0, (n, genes)).astype(np.float32)


class RandomSearch:
    """Asks `population` uniform genomes per generation; results change nothing."""

    def __init__(self, seed: int, population: int, genes: int) -> None:
        self._seed = seed
        self._size = (population, genes)

    def ask(self, generation: int) -> Genomes:
        """The next uniform genomes: (population, genes)."""
        return uniform_genomes(self._seed, generation, *self._size)

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn nothing."""


Picks = NDArray[np.intp]
Select = Callable[[ArchiveElites, int, np.random.Generator], Picks]
"""Picks n parents, as places among the elites (at least one of them)."""


class MapElites:
    """Mutates parents from the archive; uniform genomes at first and while it is empty."""

    def __init__(
        self,
        spec: RunSpec,
        genes: int,
        box: PositionBox,
        select: Select,
        make_archive: Callable[[int, PositionBox], EliteArchive] = EliteArchive,
    ) -> None:
        self.archive = make_archive(genes, box)
        self._spec = spec
        self._genes = genes
        self._select = select

    def ask(self, generation: int) -> Genomes:
        """Offspring of the elites: (population, genes)."""
        spec = self._spec
        elites = self.archive.elites
        if not len(elites):
            return uniform_genomes(spec.seed, generation, spec.population, self._genes)
        picks = self._select(elites, spec.population, keyed_generator(spec.seed, "parents", generation))
        return mutate(
            elites.genomes[picks],
            spec.mutation_sigma,
            spec.mutation_probability,
            keyed_generator(spec.seed, "mutation", generation),
        )

    def tell(self, generation: int, rows: Rows) -> None:
        """Offer the generation to the archive."""
        self.archive.insert(rows)


def mutate(parents: Genomes, sigma: float, probability: float, generator: np.random.Generator) -> Genomes:
    """Add N(0, sigma) to each gene with a probability, clipped to [-1, 1].

    As in the paper each gene is drawn on its own, so that with 7 genes at 0.3 about 8 % of the offspring are
    copies of their parents; to force a gene in them would be another operator.
    """
    mutated = generator.random(parents.shape) < probability
    steps = generator.normal(0.0, sigma, parents.shape)
    return np.clip(parents + mutated * steps, -1.0, 1.0).astype(np.float32)


def select_uniform(elites: ArchiveElites, n: int, generator: np.random.Generator) -> Picks:
    """ME_rand: uniform over the occupied cells, without replacement where there are n of them."""
    return generator.choice(len(elites), n, replace=len(elites) < n)


def select_successes(elites: ArchiveElites, n: int, generator: np.random.Generator) -> Picks:
    """ME_scs by its original definition: all successful elites, the rest drawn at random.

    n or more successes: n of them without replacement. Fewer: each once, then other elites without
    replacement; with fewer than n elites in all, each once, then any with replacement.

    The released code differs: below n successful cells it draws from the whole archive without regard to
    success, so that selection has no pressure while successes are few.
    """
    successes, others = np.flatnonzero(elites.successful), np.flatnonzero(~elites.successful)
    if len(successes) >= n:
        return generator.choice(successes, n, replace=False)
    if len(elites) >= n:
        rest = generator.choice(others, n - len(successes), replace=False)
        return np.concatenate([successes, rest])
    repeats = generator.choice(len(elites), n - len(elites), replace=True)
    return np.concatenate([successes, others, repeats])


EMITTERS = 15
CMA_POPULATION = 540  # 36 genomes for each emitter
SIGMA_0 = 0.5  # Standard deviation of an emitter's first genomes, in genes
ALPHA = 0.01  # The archive's learning rate: how far a cell's threshold moves to an inserted objective
F_MIN = -1.0  # The threshold of an empty cell


def check_cma(spec: RunSpec) -> None:
    """Refuse a spec that the emitters cannot be asked with (`ImpossibleValue`).

    Emitters share the population, and are told before they are asked again.
    """
    if spec.population % EMITTERS or spec.population < 2 * EMITTERS:
        expected = (
            f"a multiple of {EMITTERS}, at least {2 * EMITTERS}, for {spec.method} ({EMITTERS} emitters)"
        )
        raise ImpossibleValue("population", spec.population, expected)
    if spec.generations_in_flight != 1:
        expected = f"1 for {spec.method}, whose emitters adapt to the generation that they were asked last"
        raise ImpossibleValue("generations_in_flight", spec.generations_in_flight, expected)
    if spec.in_flight is not None:
        expected = f"left out for {spec.method}, which has one generation in flight"
        raise ImpossibleValue("in_flight", spec.in_flight, expected)


class CmaMae:
    """Asks each emitter for its share of a generation, and tells them all the results."""

    def __init__(self, spec: RunSpec, genes: int, box: PositionBox) -> None:
        check_cma(spec)
        _compile_adaptation()
        self._box = CellBox(box)
        self._archive = _grid(self._box, genes, *_seeds(spec.seed, "archive", 1))
        self._share = spec.population // EMITTERS
        starts = keyed_generator(spec.seed, "starts", 0).uniform(-1.0, 1.0, (EMITTERS, genes))
        self._emitters = [
            _emitter(self._archive, start, self._share, seed)
            for start, seed in zip(starts, _seeds(spec.seed, "emitters", EMITTERS), strict=True)
        ]
        self._asked = np.zeros((0, genes))

    def ask(self, generation: int) -> Genomes:
        """The emitters' genomes one after the other, clipped to [-1, 1]: (population, genes)."""
        self._asked = np.concatenate([emitter.ask() for emitter in self._emitters])
        return np.clip(self._asked, -1.0, 1.0).astype(np.float32)

    def tell(self, generation: int, rows: Rows) -> None:
        """Insert simulated rows, and adapt the emitters by the improvement of the archive.

        Before the first simulated row emitters are told nothing: they would have no elite to restart from.
        """
        places = cells(rows["descriptor"][:, :3])
        is_kept = (rows["outcome"] >= Outcome.MISSED) & self._box.contains(places)
        batch = {
            "solution": self._asked,
            "objective": np.where(is_kept, rows["fitness"].astype(np.float64), F_MIN),
            "measures": np.clip(places, self._box.low, self._box.high).astype(np.float64),
        }
        added = self._archive.add(**batch)
        for number, emitter in enumerate(self._emitters if len(self._archive) else ()):
            own = slice(number * self._share, (number + 1) * self._share)
            emitter.tell(**_part(batch, own), add_info=_part(added, own))


def _grid(box: CellBox, genes: int, seed: int) -> "GridArchive":
    """Make the archive of the emitters, whose measures are cells."""
    return box.archive(genes, learning_rate=ALPHA, threshold_min=F_MIN, seed=seed)


def _emitter(archive: "GridArchive", start: ArrayLike, share: int, seed: int) -> "EvolutionStrategyEmitter":
    from ribs.emitters import EvolutionStrategyEmitter

    return EvolutionStrategyEmitter(
        archive,
        x0=start,
        sigma0=SIGMA_0,
        ranker="imp",
        selection_rule="mu",
        restart_rule="basic",
        batch_size=share,
        seed=seed,
    )


@cache
def _compile_adaptation() -> None:
    """Have pyribs compile ask and tell (4-6 s, once a process) before any job waits for it."""
    archive = _grid(CellBox(([0.0] * 3, [0.01] * 3)), 2, 0)
    emitter = _emitter(archive, np.zeros(2), 4, 0)
    batch = {"solution": emitter.ask(), "objective": np.arange(4.0), "measures": np.zeros((4, 3))}
    emitter.tell(**batch, add_info=archive.add(**batch))
    emitter.ask()


def _seeds(seed: int, purpose: str, n: int) -> list[int]:
    """The seeds of pyribs' own generators."""
    seeds: list[int] = keyed_generator(seed, purpose, 0).integers(1 << 63, size=n).tolist()
    return seeds


def _part(columns: dict[str, Any], part: slice) -> dict[str, Any]:
    return {name: column[part] for name, column in columns.items()}
