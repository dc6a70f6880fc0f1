"""Regions of an object: the places that a hand may touch, and those that it must not.

A region is numbers in the frame of the object's mesh [m], a mesh file in that frame, or a name: in the table
`[regions]` of a TOML file, or of a part of the object's own file. When a scene is built, they become a bit
for each of many points on the surface.
"""

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import named_path, on_asset_path, read_table
from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.mesh_io import (
    FORMAT_PACKAGES,
    LARGEST_OBJECT,
    READABLE_FORMATS,
    named_parts,
    read_mesh_file,
)
from qdgrasp_assets.geometry.mesh_repair import is_surface, point_in_words
from qdgrasp_assets.geometry.proximity import inside_count
from qdgrasp_assets.geometry.surface_points import packed_points, sample_surface
from qdgrasp_assets.grippers.urdf import numbers_in
from qdgrasp_assets.scene import BORDER, Region, Scene
from qdgrasp_assets.stand_ins import MESHES
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName
from qdgrasp_protocol.spec import RunSpec

Mask = NDArray[np.bool_]
SAMPLES_PER_AREA = 4e6  # Points on the surface [1/m2]: half a millimetre apart
MOST_SAMPLES = 1 << 20
SHAPES = {"box": "x0,y0,z0,x1,y1,z1", "ball": "x,y,z,r", "above": "z"}
"""Kinds of regions in numbers [m]."""
HINT = "Or write box:x0,y0,z0,x1,y1,z1, ball:x,y,z,r or above:z, in m, or name a mesh file."


def with_regions(scene: Scene, spec: RunSpec) -> Scene:
    """Return a scene whose contacts have to be in the regions of its spec.

    They are in one of `on` and none of `avoid`, and so are its surface points. Raises `UnknownName` for the
    name of no region, `AssetError` for a region that holds no part of the surface, or where nothing is left.
    """
    from scipy.spatial import KDTree  # takes its time

    mesh, com = scene.object.mesh, np.array(scene.object.com_in_mesh)
    points, drawn = _samples(mesh)
    regions = tuple(
        Region(
            name=named_path(name).name if _is_file(name) else name,
            mask=np.packbits(_mask(name, spec, points + com)).tobytes(),
            is_allowed=is_allowed,
        )
        for is_allowed, names in ((True, spec.on), (False, spec.avoid))
        for name in names or ()
    )
    scene = structs.replace(scene, regions=regions)
    _, allowed = allowed_points(scene)
    inner = np.flatnonzero(allowed & (KDTree(points[~allowed]).query(points)[0] >= BORDER))
    if not len(inner):
        raise AssetError(
            f"The regions leave nothing of '{spec.object}' that is {1000 * BORDER:g} mm off their borders."
        )
    chosen = inner[: len(scene.surface_points)]
    ends = points[chosen].min(axis=0), points[chosen].max(axis=0)
    aimed = packed_points(mesh, points[chosen], mesh.normals[drawn[chosen]], *ends)
    return structs.replace(scene, **structs.asdict(aimed))


def allowed_points(scene: Scene) -> tuple[Floats, Mask]:
    """Return points (s, 3) [m] on a scene's object, and which contacts may be on (s,).

    The points are in the CoM frame; the scene has regions.
    """
    masks, is_on = _masks(scene), np.array([region.is_allowed for region in scene.regions])
    allowed = (masks[is_on].any(axis=0) | (not is_on.any())) & ~masks[~is_on].any(axis=0)
    return sample_surface(scene.object.mesh, len(allowed), seed=0)[0], allowed


def regions_at(scene: Scene, points: Floats) -> list[str]:
    """Return the name of the first region of a scene that each of its points is in; "" in none.

    `points` (n, 3) [m] are finite and on the object or near it, in the frame of its mesh file, which is the
    CoM frame plus `com_in_mesh`. A point is in the regions of the nearest of the points sampled there.
    """
    from scipy.spatial import KDTree

    if not scene.regions:
        return [""] * len(points)
    samples, names = allowed_points(scene)[0], [region.name for region in scene.regions]
    nearest = KDTree(samples).query(points - np.array(scene.object.com_in_mesh))[1]
    masks = np.vstack([_masks(scene)[:, nearest], np.ones(len(points), bool)])
    return [[*names, ""][first] for first in masks.argmax(axis=0)]


def _masks(scene: Scene) -> Mask:
    """Return which of the points sampled on a scene's object are in each region (r, s)."""
    packed = np.array([np.frombuffer(region.mask, np.uint8) for region in scene.regions])
    return np.unpackbits(packed, axis=1).astype(bool)


def _samples(mesh: Mesh) -> tuple[Floats, NDArray[np.int64]]:
    """Draw points (n, 3) [m] on a mesh, with their faces (n,); n is a multiple of 8."""
    return sample_surface(
        mesh, 8 * int(min(SAMPLES_PER_AREA * mesh.areas.sum(), MOST_SAMPLES) / 8 + 1), seed=0
    )


def _mask(name: str, spec: RunSpec, points: Floats) -> Mask:
    """Return which points (n, 3) [m] on an object are in a region, frame of its mesh."""
    said = _said_regions(spec.object)
    region = said.get(name, name)
    if region.partition(":")[0] in SHAPES:
        mask = _in_shape(region, points)
    elif _is_file(region):
        mesh = read_mesh_file(named_path(region), spec.scale).mesh
        if (largest := mesh.extents.max()) > LARGEST_OBJECT:
            raise AssetError(
                f"The region '{name}' is {largest:.4g} m large, and objects are smaller than "
                f"{LARGEST_OBJECT:g} m: save it in the unit of '{spec.object}'."
            )
        mask = _on_mesh(mesh, points)
    else:
        own = named_parts(named_path(spec.object), spec.scale or 1.0) if _is_file(spec.object) else {}
        if region not in own:
            raise UnknownName("region", name, {*said, *own}, HINT)
        mask = _on_mesh(own[region], points)
    if not mask.any():
        low, high = (point_in_words(end) for end in (points.min(axis=0), points.max(axis=0)))
        raise AssetError(
            f"The region '{name}' holds no part of the surface of '{spec.object}', which goes from {low} to "
            f"{high} m in the frame of its mesh; say it in that frame, and in m."
        )
    return mask


def _is_file(name: str) -> bool:
    return named_path(name).suffix.lower() in (*READABLE_FORMATS, *FORMAT_PACKAGES)


def _said_regions(name: str) -> dict[str, str]:
    """Return the regions in an object's TOML, beside its mesh or on the asset path."""
    beside = named_path(name).with_suffix(".toml")
    places = MESHES / f"{name}.toml", on_asset_path(f"objects/{name}.toml"), beside
    file = next((place for place in places if place and place.is_file()), None)
    tables = read_table(file, dict[str, dict[str, str]], "object", "docs/where.md") if file else {}
    return tables.get("regions", {})


def _in_shape(region: str, points: Floats) -> Mask:
    """Return which points (n, 3) [m] are in a region in numbers."""
    kind, _, text = region.partition(":")
    numbers = np.array(numbers_in(text.replace(",", " ")))
    if len(numbers) != SHAPES[kind].count(",") + 1:
        raise ImpossibleValue("A region", region, f"{kind}:{SHAPES[kind]}, in m")
    if kind == "box":
        low, high = np.sort(numbers.reshape(2, 3), axis=0)
        return np.asarray(((points >= low) & (points <= high)).all(axis=1))
    if kind == "ball":
        return np.asarray(np.linalg.norm(points - numbers[:3], axis=1) <= numbers[3])
    return np.asarray(points[:, 2] >= numbers[0])


def _on_mesh(region: Mesh, points: Floats) -> Mask:
    """Return which points (n, 3) [m] are near the surface of a region, or inside it."""
    from scipy.spatial import KDTree

    mask = KDTree(_samples(region)[0]).query(points)[0] <= BORDER
    if is_surface(region):
        mask |= inside_count(region, points) > 0
    return np.asarray(mask)
