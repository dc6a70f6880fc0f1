"""The assignment of a coordinator: one run, with all that is needed to carry it out."""

from dataclasses import dataclass

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_protocol.messages import OpenRun
from qdgrasp_protocol.rows import Shape


@dataclass(frozen=True)
class Assignment:
    """One run that a coordinator carries out."""

    run: str
    spec: bytes
    """The full spec as TOML."""
    bundle: Bundle
    prior: str
    shape: Shape
    pipeline: Pipeline
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
