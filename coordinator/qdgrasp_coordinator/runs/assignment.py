"""The assignment of a coordinator: one run, with all that is needed to carry it out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.counts.curve import Trail
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.runs.generation import Generation
from qdgrasp_protocol.messages import Failure, OpenRun
from qdgrasp_protocol.rows import Rows, Shape


class Agenda(Protocol):
    """What is evaluated in a run, and in which order it counts: of a search, its `Pipeline`."""

    tally: Tally
    trail: Trail

    @property
    def finished(self) -> str | None:
        """Why the run is over, in words; None while it is not."""

    def ask(self) -> Generation | None:
        """The next rows to evaluate; None when there are none now."""

    def settle(self, rows: Rows, cpu_seconds: float = 0.0, failures: Sequence[Failure] = ()) -> Stretch:
        """Take evaluated rows, in any order, and give those that have just become final."""

    def replay(self, rows: Rows) -> None:
        """Take the next recorded rows as if they had just been evaluated."""


@dataclass(frozen=True)
class Assignment:
    """One run that a coordinator carries out."""

    run: str
    spec: bytes
    """The full spec as TOML."""
    bundle: Bundle
    prior: str
    shape: Shape
    pipeline: Agenda
    evaluations: int
    """The budget."""

    @property
    def opening(self) -> OpenRun:
        """What a recorder is told of the run when it is opened."""
        return OpenRun(
            run=self.run,
            spec=self.spec,
            scene=self.bundle.digest,
            genes=self.shape.genes,
            joints=self.shape.joints,
            descriptors=self.shape.descriptors,
        )
