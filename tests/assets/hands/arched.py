"""The jaw with hollow fingers, of which the simulator would make solid ones, and a palm without a mass."""

from pathlib import Path

import trimesh
from tests.assets.hands import jaw

PAD = '<box size="0.02 0.01 0.06"/>'
"""The shape of a finger of the jaw."""
URDF = jaw.URDF.replace(PAD, '<mesh filename="arch.stl"/>').replace(
    f'<inertial><mass value="0.5"/>{jaw.INERTIA}</inertial>', ""
)
LEGS_AND_TOP = [
    [(-0.010, -0.005, -0.030), (-0.005, 0.005, 0.030)],
    [(0.005, -0.005, -0.030), (0.010, 0.005, 0.030)],
    [(-0.010, -0.005, 0.030), (0.010, 0.005, 0.035)],
]


def write_arch(path: Path) -> None:
    """Write the mesh of a finger: an arch as large as the finger of the jaw."""
    trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in LEGS_AND_TOP]).export(path)
