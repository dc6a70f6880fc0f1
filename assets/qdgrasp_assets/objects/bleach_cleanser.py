"""The stand-in of the bleach cleanser: a bottle that narrows to a waist, a grip, shoulders and a cap."""

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.chain import chain, stack

OUTLINES = (
    (0.000, -0.0235, 0.0117, 0.0465, 0.0300, 3.5),
    (0.004, -0.0235, 0.0117, 0.0490, 0.0325, 3.5),
    (0.016, -0.0225, 0.0117, 0.0490, 0.0325, 3.2),
    (0.050, -0.0195, 0.0117, 0.0475, 0.0312, 3.0),
    (0.100, -0.0170, 0.0117, 0.0465, 0.0283, 3.0),
    (0.130, -0.0150, 0.0117, 0.0446, 0.0265, 3.0),
    (0.160, -0.0128, 0.0117, 0.0409, 0.0244, 3.0),
    (0.168, -0.0112, 0.0117, 0.0388, 0.0245, 2.8),
    (0.178, -0.0095, 0.0117, 0.0360, 0.0268, 2.3),
    (0.190, -0.0072, 0.0116, 0.0354, 0.0266, 2.4),
    (0.198, -0.0080, 0.0115, 0.0350, 0.0261, 2.3),
    (0.210, -0.0126, 0.0115, 0.0352, 0.0251, 2.1),
    (0.220, -0.0105, 0.0115, 0.0283, 0.0235, 2.0),
    (0.229, -0.0126, 0.0115, 0.0150, 0.0150, 2.0),
    (0.2405, -0.0126, 0.0115, 0.0153, 0.0153, 2.0),
    (0.2425, -0.0146, 0.0115, 0.0134, 0.0115, 2.3),
    (0.250, -0.0140, 0.0115, 0.0132, 0.0120, 2.3),
)
"""Height z, centre x and y, half sides in x and y [m], power. Published: 250 mm high, foot 98 mm x 65 mm."""


def bleach_cleanser() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and convex parts of the bottle, in the frame of the scan."""
    return chain(stack(OUTLINES))
