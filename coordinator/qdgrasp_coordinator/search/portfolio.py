"""The default search: a portfolio of emitters, each asked for what it earns.

Four emitters propose poses: draws on the object's surface by one or two priors, grasps that hold turned about
the line along which their fingers press, and grasps that hold moved into cells beside theirs. A pose is worth
simulating if its cell is open, and first if its grip is open too, or, of draws, if its grip promises most;
where cells run dry, a second orientation in a cell is. What is told of any pose is known to all emitters.

Which emitter asks is a bandit on what each gained lately by its cost. A gain is the relative growth of the
cells and of the contact niches in which a grasp holds; the cost is the steps of physics that its poses took,
so that what a hopeless or slow try costs is charged. An emitter's share is its rate over the best one's to
the power of `SHARPNESS`, and `LEAST_SHARE` more. No clock decides: steps are in the rows.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_coordinator.search.base import SearchSpace, keyed_generator
from qdgrasp_coordinator.search.emitters import Emitter, NeighbourEmitter, RotationEmitter, SurfaceEmitter
from qdgrasp_coordinator.search.grasp_map import CELL_OPEN, SECOND, TRIED_OFTEN, GraspMap, Proposals
from qdgrasp_protocol.rows import Genomes, Rows
from qdgrasp_protocol.spec import RunSpec

SHARPNESS = 24
LEAST_SHARE = 0.02
GAINS_KEPT, COSTS_KEPT = 0.9, 0.98  # Of the past after 50 genomes of an emitter
TRUSTED = 20  # Genomes of an emitter before its rate is believed
UNTRUSTED = 0.3  # Its share until then, of the best one's
ROW_STEPS = 30  # Cost of a row besides its steps of physics: what a pose that overlaps takes


class EmitterBandit:
    """The shares of emitters, by gains and costs of late."""

    def __init__(self, emitters: int) -> None:
        self._gains, self._costs = np.zeros((2, emitters)), np.zeros((2, emitters))  # Sums; genomes
        self._told = np.zeros(emitters, np.int64)

    def shares(self) -> Floats:
        """Return the share (k,) of each emitter."""
        gain, cost = (sums / np.maximum(counts, 1e-9) for sums, counts in (self._gains, self._costs))
        is_trusted = self._told >= TRUSTED
        rates = np.where(is_trusted, gain / np.maximum(cost, 1e-9), 0.0)
        if best := rates.max():
            shares = LEAST_SHARE + np.where(is_trusted, (rates / best) ** SHARPNESS, UNTRUSTED)
        else:
            shares = np.ones(len(rates))
        result: Floats = shares / shares.sum()
        return result

    def learn(self, emitters: NDArray[np.intp], gains: Floats, costs: Floats) -> None:
        """Learn the gains and costs (n,) of genomes of these emitters (n,)."""
        k = len(self._told)
        counts = np.bincount(emitters, minlength=k)
        for sums, values, kept in ((self._gains, gains, GAINS_KEPT), (self._costs, costs, COSTS_KEPT)):
            sums *= kept ** (counts / 50.0)
            sums += np.stack([np.bincount(emitters, values, k), counts])
        self._told += counts


POOL = 2  # Poses that promise something new to choose from, for each asked
ROUNDS = 6  # Times that an emitter is asked for poses that promise something new


class Portfolio:
    """Asks emitters for poses in cells that lack a grasp that holds."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        self._spec = spec
        self._map = GraspMap(spec, space)
        scene, surface = space.scene, ObjectSurface(space.scene)
        priors = ("antipodal", "approach") if scene.gripper.jaw else ("approach", "contact")
        self._emitters: list[Emitter] = [
            *(SurfaceEmitter(scene, prior, surface) for prior in priors),
            RotationEmitter(self._map),
            NeighbourEmitter(scene, self._map),
        ]
        self._bandit = EmitterBandit(len(self._emitters))
        self._asked: dict[int, tuple[NDArray[np.intp], Floats]] = {}
        """The emitter of each genome of generations not told yet, and the middle of its contacts."""

    def ask(self, generation: int) -> Genomes:
        """Return the poses of a generation: (population, genes)."""
        generator = keyed_generator(self._spec.seed, "portfolio", generation)
        shares = self._bandit.shares()
        wanted = generator.multinomial(self._spec.population, shares)
        order, parts, lacking = np.argsort(-shares, kind="stable").tolist(), [], 0
        for worst in (TRIED_OFTEN, SECOND):  # second orientations only where cells run dry
            for place in order:
                n = lacking + int(wanted[place])
                parts.append((place, self._proposed(self._emitters[place], n, worst, generator)))
                lacking = n - len(parts[-1][1])
            wanted[:] = 0
        if lacking:  # nothing new is in sight: the prior that always finds poses
            parts.append((1, self._emitters[1].propose(lacking, generator)[np.arange(lacking)]))
            self._map.count_tries(parts[-1][1])
        emitters = np.concatenate([np.full(len(part), place) for place, part in parts])
        self._asked[generation] = emitters, np.concatenate([part.middles for _, part in parts])
        return np.concatenate([part.genomes for _, part in parts])

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn which poses of a generation hold, and what they cost."""
        emitters, middles = self._asked.pop(generation)
        places = rows["index"].astype(np.intp)
        gains = self._map.learn(rows, middles[places])
        self._bandit.learn(emitters[places], gains, rows["steps"] + float(ROW_STEPS))

    def _proposed(self, emitter: Emitter, n: int, worst: int, generator: np.random.Generator) -> Proposals:
        """Return at most `n` poses of an emitter of a level up to `worst`, and count them as tried."""
        found, promising = emitter.propose(n, generator), -1
        for _ in range(ROUNDS if n else 0):
            before, promising = promising, int(np.count_nonzero(self._map.levels(found) <= TRIED_OFTEN))
            if promising >= POOL * n or promising == before:
                break
            found = found.joined(emitter.propose(n, generator))
        levels = self._map.levels(found)
        if isinstance(emitter, SurfaceEmitter):  # of draws those that may be expected to gain most
            order = np.lexsort((-self._map.expected_gains(found), np.maximum(levels, CELL_OPEN)))[:n]
        else:
            order = np.argsort(levels, kind="stable")[:n]
        chosen = found[order[levels[order] <= worst]]
        self._map.count_tries(chosen)
        return chosen


class CellSampling:
    """Draws of the prior `antipodal` in open cells: the plainest sampler with one rule."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        self._spec = spec
        self._map = GraspMap(spec, space)
        self._emitter = SurfaceEmitter(space.scene, "antipodal", ObjectSurface(space.scene))
        self._middles: dict[int, Floats] = {}  # Of generations not told yet

    def ask(self, generation: int) -> Genomes:
        """Return draws in open cells, filled up with others: (population, genes)."""
        generator, n = keyed_generator(self._spec.seed, "cells", generation), self._spec.population
        drawn = self._emitter.propose(n, generator)
        for _ in range(ROUNDS):
            is_open = self._map.levels(drawn) <= CELL_OPEN
            if np.count_nonzero(is_open) >= n:
                break
            drawn = drawn.joined(self._emitter.propose(n, generator))
        is_open = self._map.levels(drawn) <= CELL_OPEN
        chosen = drawn[np.argsort(~is_open, kind="stable")[:n]]
        self._map.count_tries(chosen)
        self._middles[generation] = chosen.middles
        return chosen.genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn in which cells a grasp holds."""
        self._map.learn(rows, self._middles.pop(generation)[rows["index"].astype(np.intp)])
