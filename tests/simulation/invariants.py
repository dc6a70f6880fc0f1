"""Invariants that must hold after every event of a history; `simulation` checks most of them."""

from collections import deque

from qdgrasp_coordinator.scheduler.pipeline import most_in_flight
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_protocol.rows import Genomes, Rows
from qdgrasp_protocol.spec import RunSpec


class InvariantViolated(AssertionError):
    """An invariant, by its name, does not hold; `words` describe the case."""

    def __init__(self, invariant: str, words: str) -> None:
        super().__init__(f"{invariant}: {words}")
        self.invariant = invariant


class CheckedSearch:
    """A search that insists on the order in which it is asked and told, with as many in flight as are due."""

    def __init__(self, search: SearchAlgorithm, spec: RunSpec) -> None:
        self._search = search
        self._spec = spec
        self._asked: deque[int] = deque()
        """Numbers of genomes of the generations that are asked and not told."""
        self._told = 0

    def ask(self, generation: int) -> Genomes:
        """A generation is asked while fewer are in flight than are due after those that were told."""
        most = most_in_flight(self._spec, self._told)
        is_next = generation == self._told + len(self._asked) and len(self._asked) < most
        if not is_next:
            raise InvariantViolated("told in order", f"asked {generation} with {self._told} told")
        genomes = self._search.ask(generation)
        self._asked.append(len(genomes))
        return genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Generations in order, each once and whole, by index."""
        whole = bool(self._asked) and rows["index"].tolist() == list(range(self._asked.popleft()))
        if generation != self._told or not whole or (rows["generation"] != generation).any():
            raise InvariantViolated(
                "told in order", f"told {generation} after {self._told - 1}, {rows['index']}"
            )
        self._told += 1
        self._search.tell(generation, rows)


INVARIANTS = {
    "no machine fails": "no state machine raises what its callers do not expect",
    "no machine spins": "nobody looks up again and again with nothing heard and nothing to do",
    "settled once": "every batch is settled at most once, by a worker that was leased it, with its true rows",
    "nothing is lost": "every row that was asked and is not settled waits or is leased, in one place",
    "told in order": "the search is asked and told generation by generation, index by index, L in flight",
    "true journal": "the disk holds a beginning of the undisturbed journal",
    "recorded before forgotten": "the outbox keeps every row that is not on the disk",
    "acknowledged when durable": "no number is reported that is not on the disk",
    "epochs rise": "each turn has an epoch of its own; no rows of a lower one than the last are taken",
    "fenced": "a worker holds nothing of another epoch, or of an older join that it did not list then",
    "bounded work": "nobody is leased more than its credit, or holds more but what was taken back unheard",
    "bounded memory": "no container grows beyond its stated bound",
    "work is handed out": "no worker with credit waits while a batch does",
    "patience while cut off": "nobody is given up while the coordinator's own link is down",
    "progress": "with one worker left and nothing going wrong, rows are recorded, to the end",
}


def require(holds: bool, invariant: str, *words: object) -> None:
    """Check one thing, or raise `InvariantViolated`."""
    if not holds:
        raise InvariantViolated(invariant, " ".join(map(str, words)))
