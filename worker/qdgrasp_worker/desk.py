"""What a worker holds of one job: its join, and the batches it was leased. Pure: no bus, no clock."""

from collections import OrderedDict

from qdgrasp_protocol.messages import Control, Joined, Work


class Desk:
    """One job at this worker.

    Work counts only if it belongs to the epoch and to the join that are in force (docs/bus.md, rule 3):
    without this fence, batches that were re-queued while the link was down would be evaluated twice.
    """

    def __init__(self, job: str) -> None:
        self.job = job
        self.epoch = -1
        self.number = 0
        self.is_orphaned = False
        """Its coordinator is gone; whoever comes next may count epochs anew."""
        self.dropped = 0
        self._held: OrderedDict[bytes, Work] = OrderedDict()

    @property
    def held(self) -> list[bytes]:
        """The batches that are leased and not yet answered, in the order they came."""
        return list(self._held)

    def joining(self) -> int:
        """Begin another join; returns its number."""
        self.number += 1
        return self.number

    def joined(self, answer: Joined) -> bool:
        """Take the answer to a join; False when it comes from an older coordinator than the one known."""
        if answer.epoch < self.epoch and not self.is_orphaned:
            return False
        if answer.epoch != self.epoch:
            self._held.clear()
        self.epoch = answer.epoch
        self.is_orphaned = False
        self._drop(answer.drop)
        return True

    def follows(self, epoch: int) -> bool:
        """Whether a coordinator of this epoch may be joined."""
        return epoch >= self.epoch or self.is_orphaned

    def accept(self, work: Work) -> bool:
        """Take a leased batch; False when it is of another epoch or of an older join."""
        if work.epoch != self.epoch or work.join != self.number:
            self.dropped += 1
            return False
        self._held[work.batch] = work
        return True

    def control(self, message: Control) -> None:
        """Drop the batches that the coordinator takes back."""
        if message.epoch == self.epoch:
            self._drop(message.drop)

    def next(self) -> Work | None:
        """The batch to evaluate now; it stays held until it is answered or released."""
        return next(iter(self._held.values()), None)

    def release(self, batch: bytes) -> None:
        """Forget a batch: its result is sent, or cannot be had here."""
        self._held.pop(batch, None)

    def _drop(self, batches: list[bytes]) -> None:
        for batch in batches:
            self._held.pop(batch, None)
