"""The space of a search: what it knows of the scene that its genomes are for."""

from dataclasses import dataclass

from qdgrasp_assets.genes import archive_box, layout
from qdgrasp_assets.scene import Scene, Vector
from qdgrasp_coordinator.searches.archive import Box
from qdgrasp_protocol.genome import Layout


@dataclass(frozen=True)
class Space:
    """Genes and cells of one search."""

    layout: Layout
    """The genes of its genomes."""
    box: Box
    """The box of hand positions that are kept."""
    approach_axis: Vector = (0.0, 0.0, 1.0)
    """Unit vector in the hand's base frame that points from the palm to the object."""
    distances: tuple[float, float] = (0.0, 0.1)
    """The least and the greatest from the hand's base to the surface point that it looks at [m]."""

    @property
    def genes(self) -> int:
        """How many genes a genome has."""
        return len(self.layout)


def space(scene: Scene, prior: str) -> Space:
    """The space of genomes of `prior` in a scene.

    Raises
    ------
    JawNeeded
        The prior is for two-finger hands, and this hand is none.
    """
    hand = scene.gripper
    distances = (hand.palm_offset + hand.standoff[0], hand.reach)
    return Space(layout(scene, prior), archive_box(scene, prior), hand.approach_axis, distances)
