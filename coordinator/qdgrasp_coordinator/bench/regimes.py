"""Regimes: poses that cost differently, asked like any search's genomes.

Anywhere, most poses overlap or miss, and are rejected soon; near grasps, most are shaken to the end. A run is
a mixture of both, so that these two say what any run takes.
"""

from enum import Enum
from math import pi

import numpy as np

from qdgrasp_coordinator.searches.draws import draws
from qdgrasp_protocol.genome import Genomes, Layout
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

METHOD, PRIOR = "contact_rand", "contact"
LEAN = pi / 4
"""The greatest nu of poses among which grasps are looked for: the approach prior's."""
PARENTS = 24
"""Grasps around which poses are drawn."""
LOOKED_AT = 2048
"""Poses among which they are looked for, at most."""
SIGMA = 0.02
"""Of each gene around those of a grasp."""
FIRST = 64
"""Genomes in a generation while grasps are looked for."""


class Regime(Enum):
    """Where poses are drawn."""

    FACING = "facing the surface"
    """At most 45 degrees from the normal: here grasps are looked for."""
    ANYWHERE = "anywhere"
    """Uniform genomes."""
    NEAR = "near grasps"
    """Around the first grasps that were found."""


class Regimes:
    """Asks genomes of the prior `contact` in the regime that is its turn.

    The grasps are a function of the layout alone: they are looked for in generations of the same size.
    """

    def __init__(self, layout: Layout) -> None:
        self.regime = Regime.FACING
        self.population = FIRST
        """Genomes in a generation."""
        self.since = 0
        """The first generation of this turn."""
        self._layout = layout
        self._parents: list[Genomes] = []
        self._asked = 0
        self._looked_at = 0

    def turn(self, regime: Regime, population: int) -> None:
        """From the next generation on, ask `population` genomes of another regime at a time."""
        self.regime, self.population, self.since = regime, population, self._asked

    @property
    def has_looked(self) -> bool:
        """Whether grasps enough are known, or there is none to be found."""
        return len(self.parents) == PARENTS or self._looked_at >= LOOKED_AT

    @property
    def parents(self) -> Genomes:
        """The first grasps found: (n, d), at most `PARENTS`."""
        none = np.zeros((0, len(self._layout)), np.float32)
        return np.concatenate([none, *self._parents])[:PARENTS]

    def ask(self, generation: int) -> Genomes:
        """The next generation: (population, d)."""
        self._asked = generation + 1
        random = draws(0, self.regime.value, generation)
        if self.regime is Regime.NEAR:
            chosen = self.parents[random.integers(len(self.parents), size=self.population)]
            return np.clip(chosen + random.normal(0.0, SIGMA, chosen.shape), -1.0, 1.0).astype(np.float32)
        genomes = random.uniform(-1.0, 1.0, (self.population, len(self._layout)))
        if self.regime is Regime.FACING:
            genomes[:, self._layout.names.index("nu")] *= LEAN / pi
            genomes[:, self._layout.names.index("nu")] -= 1.0 - LEAN / pi
        return genomes.astype(np.float32)

    def tell(self, generation: int, rows: Rows) -> None:
        """Hear of the first grasps."""
        if not self.has_looked:
            self._looked_at += len(rows)
            self._parents.append(rows["genome"][rows["outcome"] >= Outcome.SHAKEN])
