"""CMA-MAE: fifteen evolution strategies on pyribs that improve their archive.

Huber et al. 2024, section IV, with the parameters of Fontaine and Nikolaidis 2023, "Covariance Matrix
Adaptation MAP-Annealing": 15 emitters of 36, alpha 0.01, f_min -1; sigma0 0.5 is that of the paper's
released code. The objective of a simulated pose is its fitness; a rejected one (overlap, dead end, error, or
a position outside the box) has f_min, so it is never inserted.

Unlike in the released code every emitter starts at a point of its own, a rejected pose is not worth as much
as a miss, and the genomes told are those asked. As there, genomes are clipped for evaluation alone.
"""

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.search.archive import CellBox, PositionBox
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Genomes, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

if TYPE_CHECKING:
    from ribs.archives import GridArchive
    from ribs.emitters import EvolutionStrategyEmitter


EMITTERS = 15
POPULATION = 540  # 36 genomes for each emitter
SIGMA_0 = 0.5  # Standard deviation of an emitter's first genomes, in genes
ALPHA = 0.01  # The archive's learning rate: how far a cell's threshold moves to an inserted objective
F_MIN = -1.0  # The threshold of an empty cell


def check(spec: RunSpec) -> None:
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
        check(spec)
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
