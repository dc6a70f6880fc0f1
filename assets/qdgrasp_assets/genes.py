"""Genes: the layout of a prior's genomes for a scene, and the box of hand positions."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import JawNeeded
from qdgrasp_protocol.rows import GIVEN, Gene, Layout

Genes = tuple[Gene, ...]
Box = tuple[NDArray[np.float64], NDArray[np.float64]]

NU_A = np.pi / 4  # Half-aperture of the approach cone (Huber et al. 2024, section III-A).
ANTIPODAL = "antipodal"  # The prior that needs a two-finger hand


def layout(scene: Scene, prior: str) -> Layout:
    """Return the genes of a prior with this scene: its own, then synergy and free joints.

    The synergy gene maps to round(values) in 0 .. m - 1; poses that are scored as given hold its label (-1:
    none) and the free joints' positions [rad] as they are. Raises `JawNeeded` where a prior for two-finger
    hands meets another hand.
    """
    gripper = scene.gripper
    synergy = (Gene("synergy", 0.0, len(gripper.synergies) - 1.0),) if gripper.synergies else ()
    free = tuple(Gene(joint.name, joint.low, joint.high) for joint in gripper.free_joints)
    return Layout(prior, PRIOR_GENES[prior](scene) + synergy + free)


def archive_box(scene: Scene, prior: str) -> Box:
    """Return low and high corner (3,) [m] of the box of hand positions, CoM frame.

    It is the object's box, enlarged by the largest distance of a hand from the surface; for spherical
    positions, which are not bound to the surface, the box of the ball that they fill.
    """
    if prior == "spherical":
        corner = np.full(3, spherical_radius(scene))
        return -corner, corner
    reach = scene.gripper.reach
    return np.array(scene.object_low) - reach, np.array(scene.object_high) + reach


def spherical_radius(scene: Scene) -> float:
    """Return L_ss [m]: the sum of the largest sides of hand (joints at zero) and object.

    The released code of the paper takes the same sum of Bullet's boxes, which are 4 to 11 mm larger.
    """
    sides = np.array(scene.object_high) - np.array(scene.object_low)
    return scene.gripper.extent + float(sides.max())


def _finder(scene: Scene) -> Genes:
    corners = zip("xyz", scene.finder_low, scene.finder_high, strict=True)
    return tuple(Gene(f"{axis}_r", low, high) for axis, low, high in corners)


def _cone(scene: Scene, aperture: float) -> Genes:
    """The genes (x_r, y_r, z_r, nu, d, xi, omega): Huber et al. 2024, eq. 2, nu before d."""
    return (
        *_finder(scene),
        Gene("nu", 0.0, aperture),
        Gene("d", *scene.gripper.standoff),
        Gene("xi", 0.0, 2 * np.pi),
        Gene("omega", 0.0, 2 * np.pi),
    )


def _antipodal(scene: Scene) -> Genes:
    """The genes theta = (x_r1, y_r1, z_r1, Omega), Huber et al. 2024, eq. 4."""
    if scene.gripper.jaw is None:
        raise JawNeeded(ANTIPODAL, scene.gripper.name)
    return (*_finder(scene), Gene("Omega", 0.0, 2 * np.pi))


def _spherical(scene: Scene) -> Genes:
    """The genes of the paper's methods without a prefix; its released code has these intervals."""
    angles = {"longitude": 2 * np.pi, "colatitude": np.pi}
    angles |= dict.fromkeys(("alpha", "beta", "gamma"), 2 * np.pi)
    radius = Gene("r", 0.0, spherical_radius(scene))
    return (radius, *(Gene(name, 0.0, high) for name, high in angles.items()))


PRIOR_GENES: dict[str, Callable[[Scene], Genes]] = {
    GIVEN: lambda _: tuple(Gene(name, -1.0, 1.0) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")),
    ANTIPODAL: _antipodal,
    "approach": lambda scene: _cone(scene, NU_A),
    "contact": lambda scene: _cone(scene, np.pi),  # approach with nu_a = pi (Huber et al. 2024, III-A)
    "spherical": _spherical,
}
