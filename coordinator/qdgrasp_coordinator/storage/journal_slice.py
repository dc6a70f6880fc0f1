"""Slices of a journal: consecutive final rows of one run, with costs and failure reasons."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Recordable, deflated
from qdgrasp_protocol.rows import COLUMNS, Rows, RowShape, pack, unpack


@dataclass(frozen=True)
class JournalSlice:
    """Rows of the journal from number `first` on."""

    first: int
    """The number of its first row; numbers count rows of the run from 0, in journal order."""
    rows: Rows
    cpu_seconds: float = 0.0
    """CPU time of these rows on workers [s]; outside the digest, so it may be an estimate."""
    failures: tuple[Failure, ...] = ()
    """Reasons of rows with `Outcome.ERROR`, by their place in `rows`."""

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def stop(self) -> int:
        """The number behind its last row."""
        return self.first + len(self.rows)

    def part(self, first: int, stop: int) -> "JournalSlice":
        """Return the part with numbers from `first` up to `stop`; the cost goes by share of rows."""
        low, high = max(first - self.first, 0), min(stop, self.stop) - self.first
        if (low, high) == (0, len(self)):
            return self
        failures = tuple(
            Failure(row=failure.row - low, reason=failure.reason)
            for failure in self.failures
            if low <= failure.row < high
        )
        cpu_seconds = self.cpu_seconds * (high - low) / len(self)
        return JournalSlice(self.first + low, self.rows[low:high], cpu_seconds, failures)


def join_slices(slices: Sequence[JournalSlice]) -> JournalSlice:
    """Join slices that follow each other; at least one."""
    if len(slices) == 1:
        return slices[0]
    first = slices[0].first
    failures = tuple(
        Failure(row=part.first - first + failure.row, reason=failure.reason)
        for part in slices
        for failure in part.failures
    )
    rows = np.concatenate([part.rows for part in slices])
    return JournalSlice(first, rows, sum(part.cpu_seconds for part in slices), failures)


def slice_to_message(part: JournalSlice, run: str, epoch: int, shape: RowShape) -> Recordable:
    """Pack a part of a run's journal into a message."""
    return Recordable(
        epoch=epoch,
        run=run,
        first=part.first,
        n=len(part),
        **asdict(shape),
        columns=deflated(pack(part.rows, COLUMNS)),
        cpu_seconds=part.cpu_seconds,
        failures=list(part.failures),
    )


def slice_from_message(message: Recordable, shape: RowShape) -> JournalSlice:
    """Return the slice in a message; raise `MessageError` for other rows or unknown failed rows."""
    came = RowShape(message.genes, message.joints, message.descriptors, message.contact_slots)
    if came != shape:
        raise MessageError(f"expected rows of {shape}, got {came}")
    if any(failure.row >= message.n for failure in message.failures):
        raise MessageError(f"a failure in a row behind its last, {message.n - 1}")
    rows = unpack(shape.empty(message.n), COLUMNS, message.columns)
    return JournalSlice(message.first, rows, message.cpu_seconds, tuple(message.failures))
