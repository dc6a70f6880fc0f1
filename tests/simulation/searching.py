"""A search that notices when it is asked or told out of order."""

from tests.coordinator.plans import Chain, Plan

from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows


class Violated(AssertionError):
    """An invariant does not hold.

    Parameters
    ----------
    invariant
        Its name.
    words
        What was seen.
    """

    def __init__(self, invariant: str, words: str) -> None:
        super().__init__(f"{invariant}: {words}")
        self.invariant = invariant


class WatchedChain(Chain):
    """`Chain`, whose asks depend on every bit of its tells; it also insists on their order."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan.population, plan.seed)
        self._in_flight = plan.in_flight
        self._count = 0
        self._heard = 0

    def ask(self, generation: int) -> Genomes:
        """Generation g is asked when generation g - L has been told."""
        if generation != self._count or generation - self._heard >= self._in_flight:
            raise Violated("told in order", f"asked {generation} with {self._heard} told")
        self._count += 1
        return super().ask(generation)

    def tell(self, generation: int, rows: Rows) -> None:
        """Generations in order, each once and whole, by index."""
        whole = rows["index"].tolist() == list(range(self._population))
        if generation != self._heard or not whole or (rows["generation"] != generation).any():
            raise Violated("told in order", f"told {generation} after {self._heard - 1}, {rows['index']}")
        self._heard += 1
        super().tell(generation, rows)
