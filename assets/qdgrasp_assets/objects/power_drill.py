"""The stand-in of the power drill: battery, handle and body, one above the other, the chuck along y.

Its outlines are those of the scan (the poisson reconstruction), in a frame turned about z with the drill; the
knobs on top are left out.
"""

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.chain import chain, stack

OUTLINES = (
    (-0.0055, -0.0105, 0.0100, 0.0120, 0.0280, 2.2),
    (0.0000, -0.0111, 0.0112, 0.0238, 0.0450, 3.0),
    (0.0060, -0.0117, 0.0112, 0.0284, 0.0515, 3.3),
    (0.0120, -0.0119, 0.0105, 0.0286, 0.0527, 3.5),
    (0.0220, -0.0122, 0.0092, 0.0250, 0.0508, 3.5),
    (0.0310, -0.0120, 0.0065, 0.0195, 0.0450, 2.6),
    (0.0390, -0.0122, -0.0130, 0.0168, 0.0235, 2.1),
    (0.0500, -0.0125, -0.0156, 0.0170, 0.0217, 2.2),
    (0.0800, -0.0126, -0.0126, 0.0192, 0.0244, 2.2),
    (0.1000, -0.0123, -0.0048, 0.0189, 0.0278, 2.0),
    (0.1180, -0.0125, -0.0004, 0.0174, 0.0375, 2.0),
    (0.1300, -0.0126, -0.0035, 0.0171, 0.0543, 2.4),
    (0.1400, -0.0127, 0.0115, 0.0218, 0.0770, 3.0),
    (0.1500, -0.0128, 0.0186, 0.0256, 0.0880, 3.6),
    (0.1600, -0.0130, 0.0203, 0.0270, 0.0899, 3.6),
    (0.1700, -0.0130, 0.0208, 0.0243, 0.0876, 3.0),
    (0.1780, -0.0132, 0.0190, 0.0185, 0.0750, 2.0),
    (0.1840, -0.0140, 0.0170, 0.0080, 0.0420, 2.0),
)
"""Height z, centre across and along the drill, half sides across and along it [m], power."""


def power_drill() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and convex parts of the drill."""
    return chain(stack(OUTLINES))
