"""Mesh files of any format that is read here, as one mesh in the unit of the file; and meshes as files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_assets.files import A_FOLDER, amiss
from qdgrasp_assets.mesh import Mesh
from qdgrasp_protocol.errors import AssetError

ALWAYS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Formats that are read with what is installed anyway."""
NEEDED = {
    ".3mf": "lxml and networkx",
    ".dae": "pycollada",
    ".zae": "pycollada",
    ".xaml": "lxml",
    ".3dxml": "lxml and networkx",
    ".step": "cascadio",
    ".stp": "cascadio",
    ".ctm": "openctm",
}
"""Packages that trimesh reads a format with, which are installed by whoever wants it."""

WRITTEN = (".stl", ".obj", ".ply", ".off", ".glb")
"""Formats that are written."""

LARGEST = 1 << 30
"""Bytes of a file; half a million triangles, the most that are taken, have 25 MB as STL, as text 140."""


@dataclass(frozen=True)
class MeshFile:
    """What a mesh file holds."""

    mesh: Mesh
    """In the unit of the file; coincident vertices of each geometry merged, all geometries joined."""
    geometries: int
    unit: float | None
    """Metres to a unit, where the file says so itself."""


def read_mesh(path: Path) -> Mesh:
    """The triangles of any mesh file that is read here; parameters and errors as of `read_mesh_file`."""
    return read_mesh_file(path).mesh


def read_mesh_file(path: Path) -> MeshFile:
    """What a mesh file holds; nothing else is checked.

    Raises
    ------
    AssetError
        It is not there, no mesh of a format that can be read here, or empty.
    """
    check_file(path)
    scene = _loaded(path)
    geometries = [found for found in scene.geometry.values() if hasattr(found, "faces")]
    if not all(np.isfinite(found.vertices).all() for found in geometries):
        raise AssetError(
            f"The mesh '{path}' has vertices that are not finite (nan or inf); export it again from the "
            "program that drew it."
        )
    for found in geometries:
        found.process()  # merges coincident vertices, and would leave those out that are not finite
    whole = scene.to_mesh()
    mesh = Mesh(np.asarray(whole.vertices, dtype=np.float64), np.asarray(whole.faces, dtype=np.int64))
    if not len(mesh.faces):
        raise AssetError(
            f"The mesh '{path}' is empty, or no {path.suffix} file: it has no triangles; an object needs a "
            "surface, and points or lines alone are none."
        )
    return MeshFile(mesh, len(scene.graph.nodes_geometry), _unit(scene))


def check_file(path: Path) -> None:
    """Check that there is a file with something in it.

    Raises
    ------
    AssetError
        It is a folder, a pipe or a device, not there, has no bytes, or too many.
    """
    if why := amiss(path):
        raise AssetError(_of_folder(path) if why == A_FOLDER else _not_there(path, why))
    size = path.stat().st_size
    if not size:
        raise AssetError(f"The mesh '{path}' is empty: the file has no bytes.")
    if size > LARGEST:
        raise AssetError(
            f"The mesh '{path}' has {size} bytes, and at most {LARGEST >> 30} GiB are read: simplify it; "
            "20 000 triangles show a finger as much."
        )


def _loaded(path: Path) -> Any:
    """What trimesh makes of the file: a scene of its geometries, as they came."""
    import trimesh
    from trimesh.exchange.load import mesh_formats

    from qdgrasp_assets.beside import Beside

    kind = path.suffix.lower()
    if kind.removeprefix(".") not in mesh_formats():
        raise AssetError(_not_read(path, kind))
    try:
        return trimesh.load_scene(path, process=False, resolver=Beside(str(path)))
    except ImportError:  # a package that guesses what damaged text was meant to be
        raise AssetError(
            f"The mesh '{path}' is damaged: it is no whole {kind} file; export it again, for example as STL."
        ) from None
    except Exception as error:  # noqa: BLE001  # trimesh's readers raise whatever they stumble over
        raise AssetError(
            f"The mesh '{path}' cannot be read as {kind}: {type(error).__name__}: {error}; export it again, "
            "for example as STL."
        ) from None


def _of_folder(path: Path) -> str:
    return (
        f"'{path}' is a folder, and an object is one mesh file; `qdgrasp campaign --objects {path}` takes "
        "every mesh in a folder."
    )


def _not_there(path: Path, why: str) -> str:
    return f"No mesh file at '{path}': it {why}; name a file such as those that end with {', '.join(ALWAYS)}."


def _not_read(path: Path, kind: str) -> str:
    if kind in NEEDED:
        return (
            f"The mesh '{path}' cannot be read: {kind} needs {NEEDED[kind]}, which is not installed; "
            f"`pip install {NEEDED[kind].replace(' and', '')}`, or export it as STL, OBJ, PLY or GLB."
        )
    return (
        f"The mesh '{path}' cannot be read: '{kind}' is not among the formats {', '.join(ALWAYS)} "
        f"({', '.join(NEEDED)} with packages of their own); export it as one of these."
    )


def _unit(scene: Any) -> float | None:
    """Metres to the unit that the file states; GLB has no other than metres."""
    from trimesh.units import unit_conversion

    try:
        return float(unit_conversion(scene.units, "meters")) if scene.units else None
    except (KeyError, ValueError):
        return None


def to_bytes(mesh: Mesh, suffix: str) -> bytes:
    """A mesh as a file of one of the formats `WRITTEN`, in the unit that it is told in."""
    import trimesh

    content: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(
        file_type=suffix.lower().removeprefix(".")
    )
    return content.encode() if isinstance(content, str) else bytes(content)
