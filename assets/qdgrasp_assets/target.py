"""Objects to grasp: a closed mesh with mass, friction and convex parts."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qdgrasp_assets.convex import collision_parts
from qdgrasp_assets.gaps import gap
from qdgrasp_assets.mesh import Floats, Mesh, parts_to_obj
from qdgrasp_assets.scene import SceneObject
from qdgrasp_assets.solid import read_solid
from qdgrasp_assets.vectors import vector
from qdgrasp_protocol.errors import AssetError

log = logging.getLogger(__name__)

LATERAL_FRICTION = 0.5
ROLLING_FRICTION = 0.01
SPINNING_FRICTION = 0.1


@dataclass(frozen=True)
class Target:
    """An object with its geometry in the frame of its mesh file."""

    name: str
    source: str
    licence: str
    collision_source: str
    mass: float
    """[kg]."""
    mesh: Mesh
    parts: tuple[Mesh, ...]
    """Convex parts that together fill the mesh."""
    com_in_mesh: Floats
    """(3,) [m]: centre of mass, mesh frame."""
    lateral_friction: float = LATERAL_FRICTION

    @property
    def centred_mesh(self) -> Mesh:
        """The mesh in the CoM frame, with float32 vertices as workers and pictures get it."""
        moved = self.mesh.moved(-self.com_in_mesh)
        return Mesh(moved.vertices.astype(np.float32).astype(np.float64), moved.faces)

    @property
    def centred_parts(self) -> tuple[Mesh, ...]:
        """The convex parts in the CoM frame."""
        return tuple(part.moved(-self.com_in_mesh) for part in self.parts)

    def packed(self) -> SceneObject:
        """The object as a scene holds it."""
        mesh = self.centred_mesh
        return SceneObject(
            name=self.name,
            source=self.source,
            licence=self.licence,
            collision_source=self.collision_source,
            mass=self.mass,
            lateral_friction=self.lateral_friction,
            rolling_friction=ROLLING_FRICTION,
            spinning_friction=SPINNING_FRICTION,
            com_in_mesh=vector(self.com_in_mesh),
            collision=parts_to_obj(self.centred_parts),
            mesh_vertices=mesh.vertices.astype("<f4").tobytes(),
            mesh_faces=mesh.faces.astype("<u4").tobytes(),
        )


def read_target(path: Path, mass: float | None, scale: float | None = None) -> Target:
    """An object from any closed mesh file; its CoM is that of the enclosed volume.

    Its convex parts serve `released` too, as the collision mesh that normals come from.

    Parameters
    ----------
    mass
        [kg]
    scale
        Metres to a unit of the file; None: 1.

    Raises
    ------
    AssetError
        The mesh cannot be used, or there is no mass.
    """
    mesh = read_solid(path, scale)
    if room := gap(mesh):
        log.warning(
            "Bodies of '%s' with about %.2g m of air between them are moved as one rigid object.", path, room
        )
    if mass is None:
        raise AssetError(f"The mesh file '{path}' has no mass; say how heavy the object is with --mass (kg).")
    return target_of(mesh, path, mass, scale)


def target_of(mesh: Mesh, path: Path, mass: float, scale: float | None = None) -> Target:
    """An object of a closed mesh [m] that was read from `path`; parameters and errors as of `read_target`."""
    collision_source, parts = collision_parts(mesh, path.name)
    return Target(
        name=path.stem,
        source=path.name if scale is None else f"{path.name} (scale {scale:g})",
        licence="not stated",
        collision_source=collision_source,
        mass=mass,
        mesh=mesh,
        parts=parts,
        com_in_mesh=mesh.centre_of_mass,
    )
