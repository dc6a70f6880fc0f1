"""Binary STL files, read without a library: every hand's meshes are such files."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
HEADER, TRIANGLE = 84, 50  # bytes
CORNERS = slice(12, 48)
"""Of a triangle's bytes those of its corners, after its normal."""


def triangles(content: bytes) -> Floats | None:
    """The corners (t, 3, 3) of the triangles of an STL file; None where it is not a binary one."""
    count = int.from_bytes(content[HEADER - 4 : HEADER], "little")
    if len(content) != HEADER + TRIANGLE * count:
        return None
    records = np.frombuffer(content, np.uint8, offset=HEADER).reshape(-1, TRIANGLE)
    corners = np.ascontiguousarray(records[:, CORNERS]).view("<f4")
    return corners.astype(np.float64).reshape(-1, 3, 3)
