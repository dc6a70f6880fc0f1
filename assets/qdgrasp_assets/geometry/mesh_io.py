"""Mesh files of any supported format, and the units of their coordinates.

A file is read as one mesh in its own unit; the scale multiplies its coordinates to metres.
"""

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_assets.asset_paths import A_FOLDER, path_problem
from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName, UnreadableHere

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}  # Metres to a unit
WORDS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches"}
LARGEST_OBJECT = 2.0  # Largest side of an object that a hand could grasp [m]
SMALLEST_OBJECT = 0.002  # Smallest size of an object that a hand could grasp [m]
LARGEST_SCALE = 1_000_000  # Most metres to a unit in a spec
MILLIMETRES = 10.0  # Size in units above which a drawing is probably in millimetres
ROUNDING = 1e-6  # Relative difference below which two scales are the same


def scale_of(units: str | float) -> float:
    """Return the metres to a unit that --units says, by name or as a number.

    Raises `UnknownName` for a unit that does not exist, `ImpossibleValue` for a scale that no mesh has.
    """
    if isinstance(units, str):
        if units not in UNITS:
            raise UnknownName("unit", units, UNITS, "Or say how many metres it is, as in --units 0.001.")
        return UNITS[units]
    if not 0 < units <= LARGEST_SCALE:
        unit = "metres to a unit of the mesh file: 0.001 for mm"
        raise ImpossibleValue(
            "--units", units, f"a number greater than 0 and at most {LARGEST_SCALE} ({unit})"
        )
    return units


def scale_in_words(scale: float) -> str:
    """Return the flag that states a scale."""
    named = [unit for unit, metres in UNITS.items() if abs(scale / metres - 1) < ROUNDING]
    return f"--units {named[0]}" if named else f"--units {scale:g}"


def scale_advice(largest: float) -> str:
    """Advise on the unit of an object too large or small, by its `largest` side read in metres."""
    fitting = [
        unit for unit, metres in UNITS.items() if 2 * SMALLEST_OBJECT < largest * metres < LARGEST_OBJECT
    ]
    if largest < LARGEST_OBJECT or not fitting:
        return "say with --units how many metres a unit of the file is"
    likely = fitting[:1] if largest >= MILLIMETRES else fitting
    looks = " or ".join(WORDS[unit] for unit in likely)
    flags = " or ".join(f"--units {unit}" for unit in likely)
    return f"it looks like {looks}: add {flags}"


def check_stated(name: str, stated: float | None, scale: float | None) -> None:
    """Check that the unit a file states is the one it is read in.

    `stated` is metres to a unit as the file says, `scale` as the user says; None: not said. Raises
    `AssetError` if the file says another unit than metres, and the user says nothing.
    """
    if stated is None or scale is not None or abs(stated - 1) < ROUNDING:
        return
    raise AssetError(
        f"The mesh '{name}' says that its unit is {stated:g} m, and meshes are read in metres: add "
        f"{scale_in_words(stated)}, or --units m if it is wrong about that."
    )


READABLE_FORMATS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Formats that are read without further packages."""
FORMAT_PACKAGES = {
    ".3mf": "lxml and networkx",
    ".dae": "pycollada",
    ".zae": "pycollada",
    ".xaml": "lxml",
    ".3dxml": "lxml and networkx",
    ".step": "cascadio",
    ".stp": "cascadio",
    ".ctm": "openctm",
}
"""Packages that trimesh needs for a format, which users install themselves."""
WRITABLE_FORMATS = (".stl", ".obj", ".ply", ".off", ".glb")  # Formats that are written
LARGEST_FILE = 1 << 30  # Largest file [bytes]; 500 000 triangles, the most allowed, have 140 MB as text STL


@dataclass(frozen=True)
class FileMesh:
    """Content of a mesh file."""

    mesh: Mesh
    """In the file's unit; each geometry's coincident vertices merged, all geometries joined."""
    geometries: int
    unit: float | None
    """Metres to a unit, if the file states it."""


def read_mesh_file(path: Path) -> FileMesh:
    """Read a mesh file; `AssetError` if it is not there, no mesh of a known format, or empty."""
    check_file(path)
    scene = _load_scene(path)
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
    from trimesh.units import unit_conversion

    unit = None  # GLB has no other than metres
    with suppress(KeyError, ValueError):
        unit = float(unit_conversion(scene.units, "meters")) if scene.units else None
    return FileMesh(mesh, len(scene.graph.nodes_geometry), unit)


def _load_scene(path: Path) -> Any:
    import trimesh
    from trimesh.exchange.load import mesh_formats

    kind = path.suffix.lower()
    if kind.removeprefix(".") not in mesh_formats():
        if packages := FORMAT_PACKAGES.get(kind):
            raise UnreadableHere(
                f"The mesh '{path}' cannot be read: {kind} needs {packages}, which is not installed; "
                f"`pip install {packages.replace(' and', '')}`, or export it as STL, OBJ, PLY or GLB."
            )
        raise AssetError(
            f"The mesh '{path}' cannot be read: '{kind}' is not among the formats "
            f"{', '.join(READABLE_FORMATS)} ({', '.join(FORMAT_PACKAGES)} with packages of their own); "
            "export it as one of these."
        )
    try:
        return trimesh.load_scene(path, process=False)
    except ImportError:  # a package that guesses what damaged text was meant to be
        raise AssetError(
            f"The mesh '{path}' is damaged: it is no whole {kind} file; export it again, for example as STL."
        ) from None
    except Exception as error:  # noqa: BLE001  # trimesh's readers raise whatever they stumble over
        raise AssetError(
            f"The mesh '{path}' cannot be read as {kind}: {type(error).__name__}: {error}; export it again, "
            "for example as STL."
        ) from None


def check_file(path: Path) -> None:
    """Check that there is a mesh file with something in it.

    Raises `AssetError` if it is a folder, a pipe or a device, is not there, or has no bytes or too many.
    """
    if why := path_problem(path):
        if why == A_FOLDER:
            raise AssetError(
                f"'{path}' is a folder, and an object is one mesh file; `qdgrasp campaign --objects {path}` "
                "takes every mesh in a folder."
            )
        raise AssetError(
            f"No mesh file at '{path}': it {why}; name a file such as those that end with "
            f"{', '.join(READABLE_FORMATS)}."
        )
    size = path.stat().st_size
    if not size:
        raise AssetError(f"The mesh '{path}' is empty: the file has no bytes.")
    if size > LARGEST_FILE:
        raise AssetError(
            f"The mesh '{path}' has {size} bytes, and at most {LARGEST_FILE >> 30} GiB are read: "
            "simplify it; 20 000 triangles show a finger as much."
        )


def linked_names(path: Path) -> tuple[str, ...]:
    """Return the names of the files with the geometry of a glTF file; none of any other format."""
    if path.suffix.lower() != ".gltf":
        return ()
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        names = [str(buffer.get("uri", "data:")) for buffer in json.loads(path.read_bytes())["buffers"]]
        return tuple(name for name in names if not name.startswith("data:"))
    return ()


def to_bytes(mesh: Mesh, suffix: str) -> bytes:
    """Return a mesh as a file of one of `WRITABLE_FORMATS`, in its own unit."""
    import trimesh

    content: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(
        file_type=suffix.lower().removeprefix(".")
    )
    return content.encode() if isinstance(content, str) else bytes(content)
