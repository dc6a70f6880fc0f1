"""A search of one's own: steps from the best genomes so far.

python own_optimiser.py runs/mine                       with workers of this machine
python own_optimiser.py runs/mine tcp/127.0.0.1:7447    with the workers of a router
"""

import sys

import numpy as np

import qdgrasp


class Climbers:
    """Keeps the best ten genomes, and asks for forty steps from them."""

    def __init__(self, layout: qdgrasp.Layout) -> None:
        self.genomes, self.fitness = np.zeros((0, len(layout))), np.zeros(0)

    def ask(self, generation: int) -> np.ndarray:
        random = np.random.default_rng([7, generation])  # what is drawn depends on the generation alone
        if not len(self.genomes):
            return random.uniform(-1, 1, (40, self.genomes.shape[1]))
        parents = self.genomes[random.integers(len(self.genomes), size=40)]
        return np.clip(parents + random.normal(0, 0.1, parents.shape), -1, 1)

    def tell(self, generation: int, rows: qdgrasp.Rows) -> None:
        genomes = np.concatenate([self.genomes, rows["genome"]])
        fitness = np.concatenate([self.fitness, rows["fitness"]])
        best = np.argsort(-fitness, kind="stable")[:10]
        self.genomes, self.fitness = genomes[best], fitness[best]


out, *router = sys.argv[1:]
place = qdgrasp.Place(connect=router[0]) if router else qdgrasp.Place()
run = qdgrasp.optimise(
    Climbers, out, evaluations=400, prior="approach", place=place, gripper="panda", object="mug"
)
print(run.summary.words)
