"""Tickets: where every batch is, and who settled it."""

from collections import OrderedDict
from dataclasses import dataclass, field

from qdgrasp_coordinator.dispatching.batch import Batch, Settlement
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Result

REMEMBERED = 10_000
"""Settled batches that are remembered, to tell duplicate and late results from unknown ones."""


@dataclass(eq=False)
class Ticket:
    """A batch and where it is."""

    batch: Batch
    attempts: int = 0
    holder: str | None = None
    """Who holds it; None: it waits to be leased."""
    since: float = 0.0
    """When it was leased last."""
    leased: set[str] = field(default_factory=set)
    """All workers that were ever leased it."""


@dataclass(eq=False)
class Stub:
    """What is kept of the ticket of a settled batch."""

    leased: set[str]
    winner: str | None
    """Who settled it; None: it was withdrawn."""


class Tickets:
    """The tickets of all open batches, and of the latest that are settled."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._open: dict[bytes, Ticket] = {}
        self._settled: OrderedDict[bytes, Stub] = OrderedDict()

    def open(self, batch: Batch) -> Ticket:
        """The ticket of a batch that is leased, made when that happens first."""
        return self._open.setdefault(batch.id, Ticket(batch))

    def find(self, batch_id: bytes) -> Ticket | None:
        """The ticket of an open batch; None: there is no such batch, or it is settled."""
        return self._open.get(batch_id)

    def of(self, run: str) -> list[Ticket]:
        """The open tickets of a run."""
        return [ticket for ticket in self._open.values() if ticket.batch.run == run]

    def close(self, ticket: Ticket, winner: str | None = None) -> None:
        """Move a batch to the settled ones, without its rows; nobody wins what is withdrawn."""
        del self._open[ticket.batch.id]
        self._settled[ticket.batch.id] = Stub(ticket.leased, winner)
        if len(self._settled) > REMEMBERED:
            self._settled.popitem(last=False)

    def judge(self, wid: str, result: Result) -> Settlement:
        """What a result on a worker's key is.

        Raises
        ------
        MessageError
            It would be fresh, but does not fit its batch.
        """
        ticket, stub = self._open.get(result.batch), self._settled.get(result.batch)
        known = ticket or stub
        if result.epoch != self._epoch or (known is not None and wid not in known.leased):
            return Settlement.FOREIGN
        if ticket is not None:
            _check(ticket.batch, result)
            return Settlement.FRESH
        if stub is not None:
            return Settlement.DUPLICATE if stub.winner == wid else Settlement.LATE
        return Settlement.UNKNOWN


def _check(batch: Batch, result: Result) -> None:
    if result.n != len(batch):
        raise MessageError(f"a result has {result.n} rows, its batch {len(batch)}")
    for failure in result.failures:
        if failure.row >= result.n:
            raise MessageError(f"a result of {result.n} rows names row {failure.row} as failed")
