"""Changes of meshes on request: a new closed surface, the convex hull, fewer triangles.

A new surface is made of the distance from what the file holds: what no point outside can reach is inside.
Lorensen's marching cubes, with one vertex for each cell (Gibson 1998, surface nets), which leaves no gaps.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.mesh_repair import drop_degenerate, is_surface, turn_outward
from qdgrasp_assets.geometry.primitives import hull
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError

CELLS = 96  # Cells of the lattice along the largest side
OFFSET = 0.8  # Distance of the surface that is looked for from what there is [cells]
KEPT_OFFSET = 0.25  # Distance at which it then stands, half the thickness that a sheet gets [cells]
SAMPLE_SPACING = 0.33  # Mean distance of the points that stand for what there is [cells]
MOST_SAMPLES = 4_000_000
MARGIN = 3  # Cells around the mesh
REMESHED_TRIANGLES = 20_000  # Triangles of a new surface unless other numbers are asked for
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])

Mask = NDArray[np.bool_]


def prepare_mesh(mesh: Mesh, preparation: MeshPreparation) -> tuple[Mesh, tuple[str, ...]]:
    """Return a mesh with the changes that are asked for, and these in words.

    The mesh need not be closed unless it is only simplified. Raises `AssetError` if it has no hull.
    """
    done = []
    if preparation.hull:
        from scipy.spatial import QhullError

        try:
            mesh = hull(mesh.vertices)
        except QhullError:
            raise AssetError(
                "it has no convex hull: its vertices lie in one plane; give it a thickness"
            ) from None
        done.append("its convex hull taken in its place")
    if preparation.remesh:
        before = len(mesh.faces)
        mesh = remesh(mesh)
        done.append(f"remeshed in {CELLS} cells along its largest side, from {before} triangles")
    wanted = preparation.simplify or (REMESHED_TRIANGLES if preparation.remesh else None)
    if wanted is not None and len(mesh.faces) > wanted:
        fewer = simplify_mesh(mesh, wanted)
        if preparation.simplify or is_surface(fewer):
            done.append(f"simplified from {len(mesh.faces)} to {len(fewer.faces)} triangles")
            mesh = fewer
    return mesh, tuple(done)


def simplify_mesh(mesh: Mesh, triangles: int) -> Mesh:
    """Return a mesh of at most so many triangles.

    By quadric edge collapse (Garland and Heckbert 1997).
    """
    from fast_simplification import simplify

    vertices, faces = simplify(
        np.ascontiguousarray(mesh.vertices), mesh.faces.astype(np.int32), target_count=triangles
    )
    found = Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    return found if is_surface(found) else drop_degenerate(found)[0]


def remesh(mesh: Mesh) -> Mesh:
    """Return a closed surface around all triangles of a mesh, wound outward.

    Space that cannot be reached from outside through gaps of more than 1.6 cells is inside; spaces within are
    filled. A sheet that is open becomes a wall of half a cell.
    """
    from scipy.spatial import KDTree

    low, high = mesh.bounds
    cell = float((high - low).max()) / CELLS
    count = min(MOST_SAMPLES, int(mesh.areas.sum() / (SAMPLE_SPACING * cell) ** 2) + len(mesh.faces))
    points = sample_surface(mesh, count, seed=0)[0]
    tree = KDTree((points - low) / cell + MARGIN)
    field = _distance_field(tree, tuple(np.ceil((high - low) / cell).astype(int) + 2 * MARGIN + 1))
    vertices, faces = surface_net(field)
    nearest = tree.data[tree.query(vertices)[1]]
    away = vertices - nearest
    vertices = nearest + away * (KEPT_OFFSET / np.linalg.norm(away, axis=1, keepdims=True))
    return turn_outward(Mesh((vertices - MARGIN) * cell + low, faces))[0]


def _distance_field(tree: Any, shape: tuple[int, ...]) -> Floats:
    """Return the distance beyond `OFFSET` [cells] at the lattice's nodes; negative inside."""
    from scipy import ndimage

    occupied: Mask = np.zeros(shape, dtype=bool)
    occupied[tuple(np.round(tree.data).astype(int).T)] = True
    near = np.argwhere(ndimage.binary_dilation(occupied, np.ones((3, 3, 3), dtype=bool), iterations=2))
    field = np.full(shape, 2.0)
    field[tuple(near.T)] = tree.query(near)[0] - OFFSET
    labels, _ = ndimage.label(field > 0)
    return np.where(labels == labels[0, 0, 0], field, -np.abs(field))


def surface_net(field: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return the surface where a field (x, y, z) changes its sign.

    Vertices are (v, 3) [cells], triangles (f, 3). The field is positive at its border. One vertex
    for each cell that the surface crosses, in the middle of its crossings; four of them around each edge that
    it crosses.
    """
    shape = np.array(field.shape) - 1
    inside = field < 0
    values = np.stack(
        [field[tuple(slice(c, c + n) for c, n in zip(corner, shape, strict=True))] for corner in CORNERS]
    )
    crossed = np.argwhere((values < 0).any(axis=0) & (values >= 0).any(axis=0))
    numbers = np.full(shape, -1)
    numbers[tuple(crossed.T)] = np.arange(len(crossed))
    own = values[:, crossed[:, 0], crossed[:, 1], crossed[:, 2]].T
    sums, counts = np.zeros((len(crossed), 3)), np.zeros(len(crossed))
    for one in range(8):
        for axis in (1, 2, 4):
            if one & axis:
                continue
            other = one | axis
            is_cut = (own[:, one] < 0) != (own[:, other] < 0)
            share = np.divide(own[:, one], own[:, one] - own[:, other], out=np.zeros(len(own)), where=is_cut)
            place = CORNERS[one] + share[:, None] * (CORNERS[other] - CORNERS[one])
            sums[is_cut] += place[is_cut]
            counts += is_cut
    faces = []
    for axis in range(3):
        across, along = (axis + 1) % 3, (axis + 2) % 3
        here = np.moveaxis(inside, axis, 0)
        ends = np.argwhere(np.moveaxis(here[:-1] != here[1:], 0, axis))
        steps = np.eye(3, dtype=int)
        a, b, c, d = (
            numbers[tuple((ends - i * steps[across] - j * steps[along]).T)]
            for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
        )
        goes_out = inside[tuple(ends.T)]
        b, d = np.where(goes_out, b, d), np.where(goes_out, d, b)
        faces += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    return crossed + sums / counts[:, None], np.concatenate(faces)
