"""Contact niches: where on the object a grasp holds, and from which side.

Two grasps are of one niche if the same number of links touch the object in the same regions, cubes of 2 cm in
its CoM frame, and the hand is on the same of 20 sides of these contacts. It is what a planner chooses among:
cells of the hand's position count shifts of one grip along the hand as well.

The sides are the directions to the vertices of a dodecahedron, turned so that the axes of an object do not
lie between two of them, as orientation bins are.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, dot, rotate, unit
from qdgrasp_coordinator.metrics.cells import GOLDEN, TURN, cell_keys
from qdgrasp_coordinator.metrics.grasp_quality import contact_values
from qdgrasp_protocol.rows import Rows

ContactNiches = NDArray[np.uint64]
"""(n,): a number for each contact niche; 0: no contact was recorded."""
REGIONS_PER_METRE = 50  # Regions of 2 cm
_CORNERS = [
    *product((-1.0, 1.0), repeat=3),
    *((0.0, a / GOLDEN, b * GOLDEN) for a, b in product((-1.0, 1.0), repeat=2)),
    *((a / GOLDEN, b * GOLDEN, 0.0) for a, b in product((-1.0, 1.0), repeat=2)),
    *((b * GOLDEN, 0.0, a / GOLDEN) for a, b in product((-1.0, 1.0), repeat=2)),
]
SIDES: Floats = unit(rotate(np.broadcast_to(unit(np.array([TURN])), (20, 4)), np.array(_CORNERS)))
"""(20, 3): unit vectors from an object to a hand on each side."""


def sides(ways: Floats) -> NDArray[np.int64]:
    """Return the side (n,), 0 to 19, to which vectors (n, 3) from contacts to a hand point."""
    nearest: NDArray[np.int64] = dot(ways[:, None], SIDES).argmax(axis=1)
    return nearest


def regions(points: Floats) -> NDArray[np.uint64]:
    """Return a number for the region of each of points (..., 3) [m]."""
    places = np.rint(points * REGIONS_PER_METRE).astype(np.int64)
    return _mixed(cell_keys(places.reshape(-1, 3)).reshape(points.shape[:-1]).astype(np.uint64))


def link_contacts(rows: Rows) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the mean contact (n, k, 3) [m] of links that touch, and their flags (n, k).

    CoM frame; a link's mean stands in the place of its first contact.
    """
    links, points = rows["contact_links"], contact_values(rows)[..., :3]
    is_same = (links[:, :, None] == links[:, None]) & (links > 0)[:, None]  # (n, contact, contact)
    counts = np.maximum(is_same.sum(axis=2), 1)
    means = (is_same[..., None] * points[:, None]).sum(axis=2) / counts[..., None]
    is_first = (is_same.argmax(axis=2) == np.arange(links.shape[1])) & (links > 0)
    return means, is_first


def contact_niches(rows: Rows) -> ContactNiches:
    """Return the contact niche of each of `rows` (n,)."""
    if not rows.dtype["contact_links"].shape[0]:  # an evaluator that records no contacts
        return np.zeros(len(rows), np.uint64)
    means, is_link = link_contacts(rows)
    count = is_link.sum(axis=1)
    centres = np.where(is_link[..., None], means, 0.0).sum(axis=1) / np.maximum(count, 1)[:, None]
    return np.where(count > 0, combined_niches(means, is_link, rows["base_to_object"][:, :3] - centres), 0)


def combined_niches(points: Floats, is_point: NDArray[np.bool_], ways: Floats) -> ContactNiches:
    """Return niches of points (n, k, 3), where they count (n, k), and ways (n, 3) to the hand."""
    with np.errstate(over="ignore"):
        together = np.where(is_point, regions(points), 0).sum(axis=1, dtype=np.uint64)
        return _mixed(together + _mixed(sides(ways).astype(np.uint64) + np.uint64(1)))


def _mixed(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread the bits of numbers (n,), so that sums of them tell sets apart (splitmix64)."""
    with np.errstate(over="ignore"):
        keys = keys + np.uint64(0x9E3779B97F4A7C15)
        keys = (keys ^ (keys >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        keys = (keys ^ (keys >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return keys ^ (keys >> np.uint64(31))
