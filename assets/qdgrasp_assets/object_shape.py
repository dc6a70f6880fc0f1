"""The shape of an object: its geometry in scenes, a value that depends on content alone.

A task names the mesh by its content, with all else that the shape depends on. Wherever the shape is built,
it is the same, and it is kept on the disk under the key of its task. Name, licence, mass and friction are no
part of it.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from qdgrasp_assets import ycb
from qdgrasp_assets.asset_paths import cache_folder, named_path, write_whole
from qdgrasp_assets.code_version import building_code, file_digest
from qdgrasp_assets.geometry.collision_parts import FingerClearance, Tell, ignore_progress
from qdgrasp_assets.geometry.mesh import parse_parts, parts_to_obj
from qdgrasp_assets.geometry.mesh_io import check_file, linked_names
from qdgrasp_assets.geometry.mesh_repair import MOST_TRIANGLES
from qdgrasp_assets.geometry.proximity import resolution_notes
from qdgrasp_assets.geometry.surface_points import SURFACES, paper_surface
from qdgrasp_assets.object_model import ObjectDraft, ObjectGeometry, geometry_of, solid_draft, warn_of_mesh
from qdgrasp_assets.scene import BodyGeometry, SurfacePoints, Words, vector
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_protocol.build_messages import ShapeTask
from qdgrasp_protocol.errors import AssetError, MessageError, QdgraspError
from qdgrasp_protocol.messages import MAX_REASON
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import printable


class ObjectShape(BodyGeometry, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The geometry of an object."""

    surface: SurfacePoints
    repairs: Annotated[tuple[Words, ...], Meta(max_length=64)] = ()
    """Repairs and changes of the mesh, in words."""
    notes: Annotated[tuple[Words, ...], Meta(max_length=64)] = ()
    """Warnings about its convex parts and fine walls."""


MAX_SHAPE = 32 << 20
"""Largest shape [bytes]: 500 000 triangles, the most, have 9 MB."""
MAX_POINTS = 1_000_000
FARTHEST = 10.0  # Greatest coordinate [m]
LONGEST_NORMAL = 1.001
_ENCODER = msgspec.msgpack.Encoder(order="sorted")


def pack_shape(shape: ObjectShape) -> bytes:
    """Return the canonical bytes of a shape."""
    return _ENCODER.encode(shape)


def unpack_shape(payload: bytes) -> ObjectShape:
    """Return the shape in bytes from anyone; `MessageError` unless all of it can be used."""
    if len(payload) > MAX_SHAPE:
        raise MessageError(f"{len(payload)} bytes are more than a shape may have ({MAX_SHAPE})")
    try:
        shape = msgspec.msgpack.decode(payload, type=ObjectShape)
        _check(shape)
    except ValueError as error:
        raise MessageError(f"not a shape: {printable(str(error), MAX_REASON)}") from None
    return shape


def _check(shape: ObjectShape) -> None:
    """Check that arrays are of the sizes that belong together, and finite; else `ValueError`."""
    surface, faces = shape.surface, shape.mesh.faces
    vertices, points, normals = map(
        _coordinates, (shape.vertices, surface.surface_points, surface.surface_normals)
    )
    low = np.array([surface.finder_low, surface.object_low])
    high = np.array([surface.finder_high, surface.object_high])
    parts = parse_parts(shape.collision.decode("ascii"))
    checks = {
        "faces": 4 <= len(faces) <= MOST_TRIANGLES and faces.max() < len(vertices),
        "surface points": 0 < len(points) == len(normals) <= MAX_POINTS,
        "normals": np.linalg.norm(normals, axis=1).max(initial=0.0) <= LONGEST_NORMAL,
        "centre of mass": np.isfinite(shape.com_in_mesh).all(),
        "boxes": (low < high).all() and np.isfinite([low, high]).all(),
        # not true of nan
        "convex parts": bool(parts) and all((np.abs(part.vertices) <= FARTHEST).all() for part in parts),
    }
    for name, is_good in checks.items():
        if not is_good:
            raise ValueError(f"its {name} cannot be used")


def _coordinates(cloud: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return coordinates (n, 3) that are finite and within reach; else `ValueError`."""
    if not (np.abs(cloud) <= FARTHEST).all():  # not true of nan
        raise ValueError("its coordinates are not finite or too large")
    return cloud


def shape_of(body: ObjectGeometry, protocol: str, seed: int, notes: tuple[str, ...] = ()) -> ObjectShape:
    """Return the shape of a body, with surface points as an evaluation protocol has them."""
    mesh, parts = body.centred_mesh, body.centred_parts
    return ObjectShape(
        collision_source=body.collision_source,
        com_in_mesh=vector(body.com_in_mesh),
        collision=parts_to_obj(parts),
        mesh_vertices=mesh.vertices.astype("<f4").tobytes(),
        mesh_faces=mesh.faces.astype("<u4").tobytes(),
        surface=SURFACES[protocol](mesh, parts, body.com_in_mesh, seed),
        repairs=body.repairs,
        notes=notes,
    )


def shape_task(spec: RunSpec) -> ShapeTask | None:
    """Return the task of building the shape of a spec's object.

    None: it is made where it is needed, an object of the catalog, or a mesh that names files by paths that no
    other folder can have. Raises `AssetError` if there is no such mesh, or too large a one.
    """
    if is_in_catalog(spec.object):
        return None
    path = named_path(spec.object)
    check_file(path)
    mesh, links = f"mesh{path.suffix.lower()}", {name: path.parent / name for name in linked_names(path)}
    if mesh in links:
        return None
    try:
        files = [
            {"name": name, "sha256": file_digest(file), "size": file.stat().st_size}
            for name, file in [(mesh, path), *links.items()]
        ]
    except OSError:  # reading the mesh says what is wrong
        return None
    values = {
        "files": files,
        "scale": spec.scale,
        "mesh": None if spec.mesh is None else msgspec.to_builtins(spec.mesh),
        "surface": "paper" if SURFACES[spec.protocol] is paper_surface else "released",
        "surface_seed": spec.surface_seed,
        "code": building_code(),
    }
    try:
        return msgspec.convert(values, ShapeTask)
    except msgspec.ValidationError:  # the name of a file is no safe one, or there are too many
        return None


def is_in_catalog(name: str) -> bool:
    """Return whether an object is a stand-in or a scan, and no mesh file."""
    return name in STAND_INS or name in ycb.SCAN_NAMES


def build_shape(task: ShapeTask, folder: Path) -> ObjectShape:
    """Build a shape from the files in a folder, which have their names in the task.

    Raises `AssetError` if they are not those of the task, or are no mesh that can be used; `QdgraspError` if
    it is to be built by other code than this.
    """
    if task.code != building_code():
        raise QdgraspError("The shape is to be built by another version of qdgrasp, or of its packages.")
    for file in task.files:
        if file_digest(folder / file.name) != file.sha256:
            raise AssetError(f"The file '{file.name}' is not the one that the shape is to be built of.")
    path = folder / task.files[0].name
    return _judged_shape(solid_draft(path, task.scale, task.mesh), task.surface, task.surface_seed)


def _judged_shape(draft: ObjectDraft, protocol: str, seed: int) -> ObjectShape:
    """Return the shape of a draft without faults, with notes on its parts and walls."""
    body = geometry_of(draft)
    fit, notes = FingerClearance(body.mesh).fit(body.parts), resolution_notes(body.mesh)
    lost = (
        f"its convex parts fill the room in front of {100 * fit.filled:.0f} % of its surface, and leave "
        f"{100 * fit.bare:.0f} % of it out, where grasps may be lost"
    )
    return shape_of(body, protocol, seed, (*(() if fit.is_good else (lost,)), *notes))


def file_shape(spec: RunSpec, tell: Tell = ignore_progress) -> ObjectShape:
    """Return the shape of a spec's mesh file, from the store, or built here and put there.

    `tell` is called with a sentence before it is built. Errors are those of `solid_draft`.
    """
    path, task = named_path(spec.object), shape_task(spec)

    def build() -> ObjectShape:
        tell(f"building the shape of {path.name}")
        draft = solid_draft(path, spec.scale, spec.mesh)
        return _judged_shape(draft, spec.protocol, spec.surface_seed)

    shape = ShapeStore().kept(task.key, build) if task else build()
    warn_of_mesh(path, shape.repairs, shape.notes)
    return shape


class ShapeStore:
    """Shapes in the cache by the keys of their tasks.

    Its folder may be deleted at any time, and several processes may use it at once.
    """

    def get(self, key: str) -> ObjectShape | None:
        """Return a shape; None if it is not there, or not whole."""
        try:
            return unpack_shape(self._file(key).read_bytes())
        except (OSError, MessageError):
            return None

    def kept(self, key: str, build: Callable[[], ObjectShape]) -> ObjectShape:
        """Return a shape, built and put here where it is not there."""
        if (shape := self.get(key)) is None:
            shape = build()
            self.put(key, pack_shape(shape))
        return shape

    def __contains__(self, key: str) -> bool:
        """Return whether a file of this key is there, whole or not."""
        return self._file(key).is_file()

    def put(self, key: str, payload: bytes) -> None:
        """Keep the bytes of a shape; what cannot be written is left out."""
        file = self._file(key)
        with suppress(OSError):
            write_whole(file, payload)

    def _file(self, key: str) -> Path:
        return cache_folder() / "shapes" / f"{key}.shape"
