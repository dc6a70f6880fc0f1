"""Objects to grasp: a closed mesh with mass, friction and convex parts.

Closed surfaces are read from mesh files in metres, and repaired where that takes no guess.
"""

import hashlib
import logging
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.asset_paths import cache_folder, named_path, write_whole
from qdgrasp_assets.code_version import building_code, file_digest
from qdgrasp_assets.geometry.collision_parts import collision_parts
from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.mesh_io import check_file, linked_names, read_mesh_file
from qdgrasp_assets.geometry.mesh_repair import (
    MOST_TRIANGLES,
    body_gap,
    fill_small_holes,
    largest_body,
    prepare_mesh,
    repair_mesh,
    surface_faults,
)
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import ObjectRecord, RunSpec

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ObjectDraft:
    """A mesh file as it would become an object."""

    mesh: Mesh
    """In metres, repaired."""
    geometries: tuple[str, ...]
    """Names of the file's geometries that are one object."""
    repairs: tuple[str, ...]
    faults: tuple[str, ...]
    """Faults that are left, in words; empty where it can be used."""

    def object_faults(self, *, glued: bool) -> tuple[str, ...]:
        """Return its faults as one rigid object; `glued`: bodies that are apart are meant as one."""
        if self.faults or glued or not (gap := body_gap(self.mesh)):
            return self.faults
        return (
            f"it is of bodies with about {gap:.2g} m of air between them, and an object is one rigid thing; "
            "give each a file of its own, say with --mesh glued that they are moved as one, or keep only one "
            "with --mesh largest",
        )


AS_IT_IS = MeshPreparation()


def read_draft(
    path: Path,
    scale: float | None = None,
    preparation: MeshPreparation | None = None,
) -> ObjectDraft:
    """Read and repair a mesh file, and list its faults as an object.

    `scale` is metres to a unit of the file; None: 1, unless the file says another unit. `preparation` are
    changes that are asked for. Raises `AssetError` if the file is not there, no mesh, empty or without area,
    or says another unit than it is read in.
    """
    asked = preparation or AS_IT_IS
    mesh, geometries = read_mesh_file(path, scale, asked.geometry)
    changes = asked.remesh or asked.hull or asked.simplify
    repairs: tuple[str, ...] = ()
    if asked.largest:
        mesh, words = largest_body(mesh)
        repairs = (words,) if words else ()
    if len(mesh.faces) > MOST_TRIANGLES and not changes:
        return ObjectDraft(mesh, geometries, repairs, surface_faults(mesh))
    if not asked.hull:
        fill = partial(fill_small_holes, flat=asked.fill) if asked.fill or asked.remesh else None
        mesh, done = repair_mesh(mesh, fill)
        repairs += done
    if changes and mesh.areas.any():
        try:
            mesh, done = prepare_mesh(mesh, asked)
        except AssetError as error:
            return ObjectDraft(mesh, geometries, repairs, (str(error),))
        mesh, after = repair_mesh(mesh)
        repairs += (*done, *after)
    if not len(mesh.faces):
        raise AssetError(f"The mesh '{path}' has no triangle with an area; draw it again.")
    return ObjectDraft(mesh, geometries, repairs, surface_faults(mesh))


def solid_draft(
    path: Path, scale: float | None = None, preparation: MeshPreparation | None = None
) -> ObjectDraft:
    """Read a closed surface in metres from any readable mesh file; one or several bodies.

    `scale` is metres to a unit of the file; None: 1. `preparation` as in `read_draft`. Raises `AssetError` as
    `read_draft`, or if it is not of a size that a hand can grasp, open, wound both ways or flat, or of bodies
    that are apart and not said to be glued.
    """
    draft = read_draft(path, scale, preparation)
    if faults := draft.object_faults(glued=bool(preparation and preparation.glued)):
        raise AssetError(f"The mesh '{path}' cannot be used: {'; and '.join(faults)}.")
    return draft


GLUED = MeshPreparation(glued=True)


def read_solid(path: Path, scale: float | None = None) -> Mesh:
    """Read a closed surface as `solid_draft`, of bodies anywhere; report repairs in a warning."""
    draft = solid_draft(path, scale, GLUED)
    warn_of_mesh(path, draft.repairs)
    return draft.mesh


def warn_of_mesh(path: Path, repairs: tuple[str, ...], notes: Iterable[str] = ()) -> None:
    """Warn of the repairs of a mesh file, and say other notes on it."""
    if repairs:
        log.warning("The mesh '%s' was repaired: %s.", path, "; ".join(repairs))
    for note in notes:
        log.warning("The mesh '%s': %s.", path, note)


LATERAL_FRICTION = 0.5


@dataclass(frozen=True, kw_only=True)
class ObjectGeometry:
    """The geometry of an object in the frame of its mesh file."""

    collision_source: str
    mesh: Mesh
    parts: tuple[Mesh, ...]
    """Convex parts that together fill the mesh."""
    com_in_mesh: Floats
    """(3,) [m]: centre of mass, mesh frame."""
    repairs: tuple[str, ...] = ()
    """Repairs and changes of the mesh, in words."""

    @property
    def centred_mesh(self) -> Mesh:
        """Mesh in the CoM frame, with float32 vertices as workers and pictures get it."""
        moved = self.mesh.moved(-self.com_in_mesh)
        return Mesh(moved.vertices.astype(np.float32).astype(np.float64), moved.faces)

    @property
    def centred_parts(self) -> tuple[Mesh, ...]:
        """Convex parts in the CoM frame."""
        return tuple(part.moved(-self.com_in_mesh) for part in self.parts)


@dataclass(frozen=True, kw_only=True)
class ObjectFacts:
    """Facts of an object besides its geometry."""

    name: str
    source: str
    licence: str
    mass: float
    """[kg]."""
    lateral_friction: float = LATERAL_FRICTION


@dataclass(frozen=True, kw_only=True)
class ObjectModel(ObjectGeometry, ObjectFacts):
    """An object with its geometry in the frame of its mesh file."""


def geometry_of(draft: ObjectDraft) -> ObjectGeometry:
    """Return the geometry of a draft without faults, with its convex parts.

    Its CoM is that of the enclosed volume; its parts serve `released` too, as the collision mesh that normals
    come from.
    """
    source, parts = collision_parts(draft.mesh)
    return ObjectGeometry(
        collision_source=source,
        mesh=draft.mesh,
        parts=parts,
        com_in_mesh=draft.mesh.centre_of_mass,
        repairs=draft.repairs,
    )


def file_facts(spec: RunSpec) -> ObjectFacts:
    """Return the facts of an object of a mesh file; `AssetError` if there is no mass."""
    path = named_path(spec.object)
    if spec.mass is None:
        raise AssetError(f"The mesh file '{path}' has no mass; say how heavy the object is with --mass (kg).")
    said = spec.about or ObjectRecord()
    changes = ((f"scale {spec.scale:g}",) if spec.scale is not None else ()) + (spec.mesh or AS_IT_IS).words
    file = f"{path.name} ({', '.join(changes)})" if changes else path.name
    return ObjectFacts(
        name=said.id or path.stem,
        source=f"{said.source}: {file}" if said.source else file,
        licence=said.licence or "not stated",
        mass=spec.mass,
        lateral_friction=LATERAL_FRICTION if spec.friction is None else spec.friction,
    )


class MeshCheck(Struct, frozen=True, kw_only=True):
    """Result of the check of a mesh file."""

    faults: tuple[str, ...]
    """Reasons why no object can be made of it, each followed by what to do about it; empty where one can."""
    volume: float = 0.0
    """[m3]."""
    triangles: int = 0
    repairs: tuple[str, ...] = ()


def check_mesh(
    path: Path, scale: float | None = None, preparation: MeshPreparation | None = None
) -> MeshCheck:
    """Check that an object can be made of a mesh file; the parameters are those of `read_draft`.

    Bodies with air between them are a fault unless they are said to be glued. Raises AssetError where there
    is no place for a cache, and no other error.
    """
    cache = cache_folder() / "checked"
    try:
        check_file(path)
        entry = cache / f"{_content_key(path, repr((scale, preparation)))}.json"
        with suppress(OSError, msgspec.MsgspecError, RecursionError):
            return msgspec.json.decode(entry.read_bytes(), type=MeshCheck)
        draft = read_draft(path, scale, preparation)
        found = MeshCheck(
            faults=draft.object_faults(glued=bool(preparation and preparation.glued)),
            volume=0.0 if draft.faults else draft.mesh.volume,
            triangles=len(draft.mesh.faces),
            repairs=draft.repairs,
        )
    except AssetError as error:
        return MeshCheck(faults=(str(error).replace(f"'{path}' ", "").rstrip("."),))
    except Exception as error:  # noqa: BLE001  # one mesh of thousands ends no campaign
        return MeshCheck(faults=(f"its check failed: {type(error).__name__}: {error}; draw it again",))
    with suppress(OSError):  # a cache that cannot be written is no error
        write_whole(entry, msgspec.json.encode(found))
    return found


def _content_key(path: Path, asked: str) -> str:
    """Return the sha256 of a mesh file's bytes, what is asked of it, and the checking code."""
    digests = [file_digest(file) for file in (path, *map(path.parent.joinpath, linked_names(path)))]
    return hashlib.sha256(
        " ".join((*digests, path.suffix.lower(), asked, building_code())).encode()
    ).hexdigest()
