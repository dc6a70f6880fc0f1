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
        self.is_draining = False
        """Its coordinator asked this worker to finish what it holds, and to leave."""
        self.dropped = 0
        self._held: OrderedDict[bytes, Work] = OrderedDict()
        self._begun: set[bytes] = set()

    @property
    def held(self) -> list[bytes]:
        """The batches that are leased and not yet answered, in the order they came."""
        return list(self._held)

    @property
    def has_joined(self) -> bool:
        """A coordinator that is there has let this worker in."""
        return self.epoch >= 0 and not self.is_orphaned

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
            self.is_draining = False
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
        """Drop the batches that the coordinator takes back, and begin to leave where it asks for that."""
        if message.epoch == self.epoch:
            self._drop(message.drop)
            self.is_draining |= message.drain

    def holds(self, batch: bytes) -> bool:
        """Whether the result of a batch is waited for."""
        return batch in self._held

    @property
    def waiting(self) -> list[Work]:
        """The batches that are held and not begun, in the order they came."""
        return [work for batch, work in self._held.items() if batch not in self._begun]

    def next(self) -> Work | None:
        """The batch to begin now; None: none waits."""
        return next(iter(self.waiting), None)

    def begin(self) -> Work | None:
        """The batch to begin now, as begun; it stays held until it is answered or released."""
        work = self.next()
        if work is not None:
            self._begun.add(work.batch)
        return work

    def release(self, batch: bytes) -> None:
        """Forget a batch: its result is sent, or cannot be had here."""
        self._held.pop(batch, None)
        self._begun.discard(batch)

    def hand_back(self, keep: bytes | None) -> None:
        """Forget all batches but one; the next join, which lists what is held, has others evaluate them."""
        self._drop([batch for batch in self._held if batch != keep])

    def _drop(self, batches: list[bytes]) -> None:
        for batch in batches:
            self._held.pop(batch, None)
