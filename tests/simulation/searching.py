"""A search that notices when it is asked or told out of order."""

from collections import deque

from qdgrasp_coordinator.searches.search import Search
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


class Watched:
    """A search that insists on the order in which it is asked and told.

    Parameters
    ----------
    search
        The search itself.
    in_flight
        How many generations may be asked and not told.
    """

    def __init__(self, search: Search, in_flight: int) -> None:
        self._search = search
        self._in_flight = in_flight
        self._asked: deque[int] = deque()
        """How many genomes the generations have that are asked and not told."""
        self._told = 0

    def ask(self, generation: int) -> Genomes:
        """Generation g is asked when generation g - L has been told."""
        is_next = generation == self._told + len(self._asked) and len(self._asked) < self._in_flight
        if not is_next:
            raise Violated("told in order", f"asked {generation} with {self._told} told")
        genomes = self._search.ask(generation)
        self._asked.append(len(genomes))
        return genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Generations in order, each once and whole, by index."""
        whole = bool(self._asked) and rows["index"].tolist() == list(range(self._asked.popleft()))
        if generation != self._told or not whole or (rows["generation"] != generation).any():
            raise Violated("told in order", f"told {generation} after {self._told - 1}, {rows['index']}")
        self._told += 1
        self._search.tell(generation, rows)
