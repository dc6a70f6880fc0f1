"""The object as files of grasps describe it: its mesh in the frame of the poses, and what it weighs."""

from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneObject
from qdgrasp_coordinator.exchange.frames import COM, Frame


@dataclass(frozen=True)
class Body:
    """A solid of uniform density."""

    mesh: Mesh
    """[m], in the frame that poses are told in."""
    mass: float
    """[kg]."""
    com: Floats
    """(3,) [m]: the centre of mass."""

    @property
    def volume(self) -> float:
        """Of what the mesh encloses [m3]."""
        return self.mesh.volume

    @property
    def density(self) -> float:
        """[kg/m3]."""
        return self.mass / self.volume

    @property
    def inertia(self) -> Floats:
        """(3, 3) [kg m2]: about the centre of mass, along the axes of the mesh.

        Integrals over the tetrahedra between triangles and centre (Tonon 2004, "Explicit exact formulas for
        the 3-D tetrahedron inertia tensor in terms of its vertex coordinates").
        """
        a, b, c = np.moveaxis(self.mesh.corners - self.com, 1, 0)
        volumes = np.einsum("ij,ij->i", np.cross(a, b), c) / 6
        total = a + b + c
        seconds = np.einsum("n,nki,nkj->ij", volumes, (s := np.stack([a, b, c, total], axis=1)), s) / 20
        inertia: Floats = self.density * (np.trace(seconds) * np.eye(3) - seconds)
        return inertia


def body(thing: SceneObject, frame: Frame) -> Body:
    """The object of a scene, told in one of its frames."""
    com = np.zeros(3) if frame == COM else np.array(thing.com_in_mesh)
    vertices = np.frombuffer(thing.mesh_vertices, dtype="<f4").reshape(-1, 3).astype(np.float64)
    faces = np.frombuffer(thing.mesh_faces, dtype="<u4").reshape(-1, 3).astype(np.int64)
    return Body(Mesh(vertices + com, faces), thing.mass, com)
