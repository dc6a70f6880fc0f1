"""Given poses: one pass over poses that are scored as they are (prior "given")."""

from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows


class Given:
    """Asks given poses in their order, at most `population` in a generation, each once.

    Parameters
    ----------
    poses
        (n, d) float32, laid out as `layout(scene, GIVEN)` says; not confined to [-1, 1].
    population
        The most rows in a generation.
    """

    def __init__(self, poses: Genomes, population: int) -> None:
        self._poses = poses
        self._population = population

    def ask(self, generation: int) -> Genomes:
        """The next poses; no rows when all have been asked."""
        first = generation * self._population
        return self._poses[first : first + self._population]

    def tell(self, generation: int, rows: Rows) -> None:
        """Nothing is learned."""
