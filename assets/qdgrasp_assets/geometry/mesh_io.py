"""Mesh files of any supported format, and the units of their coordinates.

A file is read as one mesh; the scale multiplies its coordinates to metres.
"""

import io
import json
import re
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdgrasp_assets.asset_paths import A_FOLDER, path_problem
from qdgrasp_assets.geometry.mesh import Mesh, join, named_groups, unreadable_as
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


READABLE_FORMATS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Formats that are read without further packages."""
FORMAT_PACKAGES = {
    ".3mf": "lxml and networkx",
    ".dae": "pycollada",
    ".step": "cascadio",
    ".stp": "cascadio",
}
"""Packages that trimesh needs for a format, which users install themselves."""
WRITABLE_FORMATS = (".stl", ".obj", ".ply", ".off", ".glb")  # Formats that are written


class FileMesh(NamedTuple):
    """Content of a mesh file."""

    mesh: Mesh
    """In metres; each geometry's coincident vertices merged, all geometries joined."""
    geometries: tuple[str, ...]
    """Their names."""


def read_mesh_file(path: Path, scale: float | None = None, geometry: str = "") -> FileMesh:
    """Read a mesh file, or one geometry of it.

    `scale` is metres to a unit of the file; None: 1, unless the file says another unit. Raises `AssetError`
    if it says so, is not there, no mesh of a known format, or empty, or has no such geometry.
    """
    check_file(path)
    scene = _load_scene(path)
    names = tuple(scene.graph[node][1] for node in scene.graph.nodes_geometry)
    if geometry:
        if geometry not in names:
            raise AssetError(f"The mesh '{path}' has no geometry '{geometry}', but {', '.join(names)}.")
        scene.delete_geometry({*names} - {geometry})
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

    stated = 1.0  # GLB has no other than metres
    with suppress(KeyError, ValueError):
        stated = float(unit_conversion(scene.units, "meters")) if scene.units else 1.0
    if scale is None and abs(stated - 1) >= ROUNDING:
        raise AssetError(
            f"The mesh '{path}' says that its unit is {stated:g} m, and meshes are read in metres: add "
            f"{scale_in_words(stated)}, or --units m if it is wrong about that."
        )
    return FileMesh(mesh if scale is None else mesh.scaled(scale), (geometry,) if geometry else names)


OBJ_NAMES = re.compile(r"[ \t]*(o|g|usemtl)[ \t]")
NAMELESS = "geometry_0"  # Of trimesh, for the mesh of a file that has no names
MOST_COLOURS = 64  # Colours of a file whose faces are painted to tell parts; a scan has more


def named_parts(path: Path, scale: float) -> dict[str, Mesh]:
    """Return the parts of a mesh file that have names; `scale` is metres to its unit.

    They are groups, objects and materials of an OBJ file, nodes, geometries and materials of others, and
    faces of a colour as "#ff0000". Errors of `read_mesh_file`.
    """
    check_file(path)
    found: dict[str, list[Mesh]] = {}
    if path.suffix.lower() == ".obj":
        with unreadable_as("The mesh '{}' has groups that cannot be read: {}.", path):
            for kinds, mesh in named_groups(path.read_text("utf-8", "replace"), OBJ_NAMES):
                for name in {*kinds.values(), *kinds.get("g", "").split()}:
                    found.setdefault(name, []).append(mesh)
    else:
        for name, mesh in _scene_parts(_load_scene(path)):
            found.setdefault(name, []).append(mesh)
        found.pop(path.name, None)  # of a format without names
    return {name: join(meshes).scaled(scale) for name, meshes in found.items()}


def _scene_parts(scene: Any) -> Iterator[tuple[str, Mesh]]:
    """Yield the names in a scene of trimesh, with placed meshes; a node has all below it."""
    for node in scene.graph.nodes_geometry:
        frame, geometry = scene.graph[node]
        found, above = scene.geometry[geometry], [node]
        if not hasattr(found, "faces"):  # points and lines
            continue
        while (parent := scene.graph.transforms.parents.get(above[-1])) not in (None, scene.graph.base_frame):
            above.append(parent)
        mesh = Mesh(np.asarray(found.vertices) @ frame[:3, :3].T + frame[:3, 3], np.asarray(found.faces))
        material = getattr(getattr(found.visual, "material", None), "name", None)
        yield from ((name, mesh) for name in {*above, geometry, material} - {None, NAMELESS})
        if found.visual.kind in ("face", "vertex"):
            colours, numbers = np.unique(found.visual.face_colors[:, :3], axis=0, return_inverse=True)
            for number, colour in enumerate(colours.tolist() if len(colours) <= MOST_COLOURS else ()):
                yield f"#{bytes(colour).hex()}", Mesh(mesh.vertices, mesh.faces[numbers.ravel() == number])


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
    advice = "export it again, for example as STL"
    with unreadable_as(f"The mesh '{{}}' cannot be read as {kind}: {{}}; {advice}.", path):
        if kind == ".ply":  # whose comments may be text of any encoding
            header, end, data = path.read_bytes().partition(b"end_header")
            header = header.decode("latin-1").encode("ascii", "replace")
            return trimesh.load_scene(io.BytesIO(header + end + data), file_type="ply", process=False)
        if kind not in (".glb", ".gltf"):
            return trimesh.load_scene(path, process=False)
        document = _gltf_document(path)
        _check_extensions(path, document)
        scene = trimesh.load_scene(path, process=False)
        _apply_normalisation(scene, document)
        return scene


DRACO = "KHR_draco_mesh_compression"
HARMLESS = ("KHR_mesh_quantization", "KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights")
"""Beginnings of the names of glTF extensions that are applied, or change no geometry."""
NORMALISED = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
"""The integer that stands for 1, by glTF's number of its type."""
DRAWN_MODES = (0, 1, 4, 5)  # Modes of glTF primitives that trimesh makes a geometry of


def _gltf_document(path: Path) -> dict[str, Any]:
    """Return the JSON document of a glTF or GLB file."""
    content = path.read_bytes()
    if content[:4] == b"glTF":
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    document: dict[str, Any] = json.loads(content)
    return document


def _check_extensions(path: Path, document: dict[str, Any]) -> None:
    """Raise UnreadableHere for a glTF file that needs an extension which is not applied."""
    for name in document.get("extensionsRequired", ()):
        if not name.startswith(HARMLESS) and not (name == DRACO and find_spec("DracoPy")):
            package = "`pip install DracoPy`, or " if name == DRACO else ""
            raise UnreadableHere(
                f"The mesh '{path}' needs the glTF extension {name}, which is not read here: {package}export "
                "it without compression and extensions, or as STL."
            )


def _apply_normalisation(scene: Any, document: dict[str, Any]) -> None:
    """Divide positions in normalised integers by what stands for 1; trimesh does not."""
    primitives = [each for mesh in document.get("meshes", ()) for each in mesh["primitives"]]
    drawn = [each for each in primitives if each.get("mode", 4) in DRAWN_MODES]
    accessors = [document["accessors"][each["attributes"]["POSITION"]] for each in drawn]
    if any(accessor.get("normalized") for accessor in accessors):
        for found, accessor in zip(scene.geometry.values(), accessors, strict=True):
            if accessor.get("normalized"):
                found.vertices = np.maximum(found.vertices / NORMALISED[accessor["componentType"]], -1.0)


def check_file(path: Path) -> None:
    """Check that there is a mesh file with something in it.

    Raises `AssetError` if it is a folder, a pipe or a device, is not there, has no bytes, or is what a server
    or Git put in the place of a mesh.
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
    with path.open("rb") as file:
        content = file.read(512)
    if not content:
        raise AssetError(f"The mesh '{path}' is empty: the file has no bytes.")
    beginning = content.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if beginning.startswith(b"version https://git-lfs"):
        raise AssetError(
            f"'{path}' is a pointer of Git LFS, not the mesh: `git lfs pull` in its repository fetches it."
        )
    if beginning.startswith((b"<!doctype html", b"<html")):
        raise AssetError(
            f"'{path}' is a web page, not the mesh: download the file itself (often called raw)."
        )


def linked_names(path: Path) -> tuple[str, ...]:
    """Return the names of the files with the geometry of a glTF file; none of any other format."""
    if path.suffix.lower() != ".gltf":
        return ()
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        names = [str(buffer.get("uri", "data:")) for buffer in _gltf_document(path)["buffers"]]
        return tuple(name for name in names if not name.startswith("data:"))
    return ()


def to_bytes(mesh: Mesh, suffix: str) -> bytes:
    """Return a mesh as a file of one of `WRITABLE_FORMATS`, in its own unit."""
    import trimesh

    content: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(
        file_type=suffix.lower().removeprefix(".")
    )
    return content.encode() if isinstance(content, str) else bytes(content)
