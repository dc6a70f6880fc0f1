"""Spaces of searches that need no scene."""

import numpy as np

from qdgrasp_coordinator.searches.space import Space
from qdgrasp_protocol.genome import Gene, Layout

BOX = (np.full(3, -0.2), np.full(3, 0.2))


def plain(genes: int) -> Space:
    """A space of genes that stand for themselves, around a box of 40 cm."""
    return Space(Layout("contact", tuple(Gene(f"gene {i}", -1.0, 1.0) for i in range(genes))), BOX)
