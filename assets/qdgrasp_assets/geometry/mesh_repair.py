"""Checks of whether a mesh is one closed surface, repairs, and gaps between its bodies.

Checks say all that is wrong in words; each repair changes what it must, and says so. A mesh that is a
closed surface already is left as it is, to the last bit: whatever was found with it is found again.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh, hull
from qdgrasp_assets.geometry.mesh_io import LARGEST_OBJECT, SMALLEST_OBJECT, scale_advice
from qdgrasp_assets.geometry.proximity import inside_count
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError

FLATTEST = 1e-12  # Least volume of a closed mesh with an inside [m3]
MOST_TRIANGLES = 500_000
"""Most triangles of an object: they travel to every worker, and are checked one by one."""

Numbers = NDArray[np.int64]


def surface_faults(mesh: Mesh) -> tuple[str, ...]:
    """Return all faults of a mesh as a surface in metres; empty if it has no fault."""
    if not np.isfinite(mesh.vertices).all():
        return ("it has vertices that are not finite",)
    if len(mesh.faces) > MOST_TRIANGLES:
        return (
            f"it has {len(mesh.faces)} triangles, and at most {MOST_TRIANGLES} are taken; "
            "simplify it, for example with --mesh simplify=20000",
        )
    return tuple(_surface_faults(mesh, MeshEdges(mesh)))


@dataclass(frozen=True)
class MeshEdges:
    """The edges of a mesh, and the number of triangles of each."""

    mesh: Mesh

    @cached_property
    def directed(self) -> Numbers:
        """(3 f, 2): directed edges of the triangles; those of triangle i are i, f + i, 2 f + i."""
        faces = self.mesh.faces
        return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])

    @cached_property
    def edge_numbers(self) -> Numbers:
        """(3 f,): index of each directed edge regardless of its direction."""
        low, high = self.directed.min(axis=1), self.directed.max(axis=1)
        return np.unique(low * len(self.mesh.vertices) + high, return_inverse=True)[1].reshape(-1)

    @cached_property
    def triangle_counts(self) -> Numbers:
        """(e,): number of triangles of each edge."""
        return np.bincount(self.edge_numbers)

    @property
    def is_closed(self) -> bool:
        """True if every edge has an even number of triangles."""
        return not (self.triangle_counts % 2).any()

    @cached_property
    def torn_edges(self) -> int:
        """Number of edges along which more triangles run one way than the other."""
        upward = np.where(self.directed[:, 0] < self.directed[:, 1], 1, -1)
        return int(np.count_nonzero(np.bincount(self.edge_numbers, weights=upward)))

    @cached_property
    def open_edges(self) -> Numbers:
        """(k, 2): directed edges with one triangle only."""
        return np.asarray(self.directed[self.triangle_counts[self.edge_numbers] == 1])

    @cached_property
    def holes(self) -> tuple[Numbers, ...]:
        """Loose edges (k, 2) around each hole, the widest first."""
        if not len(self.open_edges):
            return ()
        labels = _connected(self.open_edges, len(self.mesh.vertices))[self.open_edges[:, 0]]
        found = [self.open_edges[labels == label] for label in np.unique(labels)]
        return tuple(sorted(found, key=lambda hole: -edges_width(self.mesh, hole)))


def edges_width(mesh: Mesh, edges: Numbers) -> float:
    """Return the largest side of the bounding box of edges (k, 2) [m]."""
    return float(np.ptp(mesh.vertices[edges.reshape(-1)], axis=0).max())


def edges_middle(mesh: Mesh, edges: Numbers) -> Floats:
    """Return the middle (3,) [m] of the bounding box of edges (k, 2)."""
    points = mesh.vertices[edges.reshape(-1)]
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def bodies(mesh: Mesh) -> Numbers:
    """Return the body (f,) of each triangle, numbered from 0; a body's triangles share vertices."""
    faces = mesh.faces
    labels = _connected(np.concatenate([faces[:, :2], faces[:, 1:]]), len(mesh.vertices))
    _, numbers = np.unique(labels[faces[:, 0]], return_inverse=True)
    return numbers.reshape(-1)


def body_volumes(mesh: Mesh) -> Floats:
    """Return the volume (b,) [m3] of each body; negative for an inverted one, such as a hollow."""
    return np.bincount(bodies(mesh), weights=mesh.cone_volumes).astype(np.float64)


def _connected(pairs: Numbers, count: int) -> Numbers:
    """Return the connected component (count,) of each vertex, joined by pairs (k, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def point_in_words(point: Floats) -> str:
    """Return a point (3,) [m] in words."""
    return "(" + ", ".join(f"{number:.4f}" for number in point) + ")"


def _surface_faults(mesh: Mesh, edges: MeshEdges) -> Iterator[str]:
    largest = float(mesh.extents.max())
    if not SMALLEST_OBJECT <= largest <= LARGEST_OBJECT:
        size = " x ".join(f"{side:.4g}" for side in mesh.extents)
        kind = "larger" if largest > LARGEST_OBJECT else "smaller"
        yield f"it is {size} m large, {kind} than what a hand grasps; {scale_advice(largest)}"
    odd = np.flatnonzero(edges.triangle_counts % 2)
    if len(edges.open_edges):
        widest, count = edges.holes[0], len(edges.holes)
        yield (
            f"it is not closed (watertight): {len(edges.open_edges)} edges have only one triangle, around "
            f"{'1 hole' if count == 1 else f'{count} holes, the largest'} {edges_width(mesh, widest):.4f} m "
            f"wide at {point_in_words(edges_middle(mesh, widest))}; close it in the program that drew it, or "
            "take --mesh fill (small holes and flat rims), remesh or hull"
        )
    elif len(odd):
        where = point_in_words(edges_middle(mesh, edges.directed[edges.edge_numbers == odd[0]]))
        yield (
            f"it is not closed (watertight): {len(odd)} edges have an odd number of triangles, one at "
            f"{where}; take out the sheets that stand in it, or take --mesh remesh or hull"
        )
    if edges.is_closed and edges.torn_edges:
        yield (
            f"its triangles are wound both ways along {edges.torn_edges} edges, and cannot all face outward: "
            "it has no inside, like a Klein bottle; draw it again, or take --mesh remesh or hull"
        )
    if edges.is_closed and abs(mesh.volume) < FLATTEST:
        yield "it is flat: it encloses no volume; give it a thickness, such as that of --mesh remesh"


TOUCHING = 1e-5  # Vertices nearer to each other than this share of the largest side are one
SMALL_HOLE = 0.2  # Largest hole that is filled on request, as a share of the largest side
FLAT = 0.05  # Largest height of a flat rim, as a share of its width: triangles of a scan end unevenly
FOLDED = 0.05  # Largest share of the fan over a flat rim that may be folded
DOUBLED = 1e-3  # Least relative change of volume by which a closed surface is found to be there twice


def repair_mesh(
    mesh: Mesh, fill: Callable[[Mesh], tuple[Mesh, str]] | None = None
) -> tuple[Mesh, tuple[str, ...]]:
    """Repair a mesh to a closed surface wound outward, if possible; returns the changes too.

    `fill` closes holes where that is asked for.
    """
    mesh, words = drop_doubled(mesh)
    done = [words]
    for step in (merge_vertices, drop_degenerate, wind_alike, *((fill,) if fill else ())):
        if is_surface(mesh):
            break
        mesh, words = step(mesh)
        done.append(words)
    if is_surface(mesh):
        mesh, words = turn_outward(mesh)
        done.append(words)
    return mesh, tuple(words for words in done if words)


def is_surface(mesh: Mesh) -> bool:
    """Return whether a mesh is closed and consistently wound."""
    edges = MeshEdges(mesh)
    return edges.is_closed and not edges.torn_edges


def merge_vertices(mesh: Mesh) -> tuple[Mesh, str]:
    """Merge vertices at nearly the same place, which closes seams of textures and geometries."""
    size = mesh.extents.max() or 1.0
    places = np.round((mesh.vertices - mesh.vertices.min(axis=0)) / (TOUCHING * size))
    _, first, merged = np.unique(places.astype(np.int64), axis=0, return_index=True, return_inverse=True)
    fewer = len(mesh.vertices) - len(first)
    if not fewer:
        return mesh, ""
    return Mesh(mesh.vertices[first], merged.reshape(-1)[mesh.faces]), f"{fewer} vertices merged with others"


def drop_doubled(mesh: Mesh) -> tuple[Mesh, str]:
    """Remove the second of closed surfaces at the same place, wound alike or the other way."""
    if not is_surface(mesh):
        return mesh, ""
    whole = merge_vertices(mesh)[0]
    for keeps_one in (False, True):
        single, words = drop_degenerate(whole, keeps_one=keeps_one)
        before, after = abs(mesh.volume), abs(single.volume)
        if words and abs(after - before) > DOUBLED * max(before, after) and MeshEdges(single).is_closed:
            return wind_alike(single)[0], f"a closed surface was there twice: {words}"
    return mesh, ""


def drop_degenerate(mesh: Mesh, *, keeps_one: bool = False) -> tuple[Mesh, str]:
    """Remove degenerate and duplicate triangles, and both of two back to back, or one of them."""
    corners = np.sort(mesh.faces, axis=1)
    whole = np.flatnonzero((np.diff(corners, axis=1) > 0).all(axis=1))
    _, first, groups = np.unique(corners[whole], axis=0, return_index=True, return_inverse=True)
    faces = mesh.faces[whole]
    # corners rise after the lowest one, or fall: opposite for triangles back to back
    rolled = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    rising = rolled[:, 1] < rolled[:, 2]
    up, down = (
        np.bincount(groups.reshape(-1), weights=way, minlength=len(first)) for way in (rising, ~rising)
    )
    kept = np.sort(whole[first[(up != down) | keeps_one]])
    dropped = len(mesh.faces) - len(kept)
    if not dropped:
        return mesh, ""
    return Mesh(mesh.vertices, mesh.faces[kept]), f"{dropped} degenerate or duplicate triangles dropped"


def wind_alike(mesh: Mesh) -> tuple[Mesh, str]:
    """Wind neighbours alike, each body as most of its triangles are."""
    edges, count = MeshEdges(mesh), len(mesh.faces)
    order = np.argsort(edges.edge_numbers, kind="stable")
    paired = order[edges.triangle_counts[edges.edge_numbers[order]] == 2].reshape(-1, 2)
    one, other = paired.T % count
    alike = edges.directed[paired[:, 0], 0] != edges.directed[paired[:, 1], 0]
    # each triangle stands twice, as it is and turned; neighbours that fit are joined
    mate = np.where(alike, other, other + count)
    rows, columns = np.concatenate([one, one + count]), np.concatenate([mate, (mate + count) % (2 * count)])
    labels = _connected(np.column_stack([rows, columns]), 2 * count)
    votes = np.bincount(labels[:count], minlength=labels.max() + 1)
    as_is, as_turned = votes[labels[:count]], votes[labels[count:]]
    is_turned = (as_turned > as_is) | ((as_turned == as_is) & (labels[count:] < labels[:count]))
    is_turned &= labels[:count] != labels[count:]
    return _with_turned(mesh, is_turned, "wound like their neighbours")


def turn_outward(mesh: Mesh) -> tuple[Mesh, str]:
    """Turn bodies that are inside out."""
    labels, wrong = bodies(mesh), inverted_bodies(mesh)
    if not wrong.any():
        return mesh, ""
    if wrong.all():
        return mesh.flipped(), "its triangles turned: it was inside out (negative volume)"
    fixed, _ = _with_turned(mesh, wrong[labels], "")
    return fixed, f"{wrong.sum()} of {len(wrong)} bodies turned: they were inside out (negative volume)"


def _with_turned(mesh: Mesh, is_turned: NDArray[np.bool_], why: str) -> tuple[Mesh, str]:
    if not is_turned.any():
        return mesh, ""
    faces = np.where(is_turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    return Mesh(mesh.vertices, faces), f"{is_turned.sum()} triangles turned, {why}"


def inverted_bodies(mesh: Mesh) -> NDArray[np.bool_]:
    """Return a mask (b,) of bodies of negative volume that are not a hollow within another one."""
    wrong: NDArray[np.bool_] = body_volumes(mesh) < 0
    return wrong & (_holders(mesh, bodies(mesh)) == np.arange(len(wrong))) if len(wrong) > 1 else wrong


def fill_small_holes(mesh: Mesh, *, flat: bool = False) -> tuple[Mesh, str]:
    """Close small holes, and `flat` ones too, with fans around the middle of their rims."""
    widest = SMALL_HOLE * mesh.extents.max()
    rims = [
        hole
        for hole in MeshEdges(mesh).holes
        if np.array_equal(np.unique(hole[:, 0]), np.sort(hole[:, 1]))  # it visits each vertex once
        and (edges_width(mesh, hole) <= widest or (flat and _is_flat(mesh, hole)))
    ]
    if not rims:
        return mesh, ""
    vertices, faces = [mesh.vertices], [mesh.faces]
    for number, rim in enumerate(rims):
        vertices.append(mesh.vertices[rim[:, 0]].mean(axis=0)[None])
        centre = np.full(len(rim), len(mesh.vertices) + number)
        faces.append(np.stack([rim[:, 1], rim[:, 0], centre], axis=1))
    where = point_in_words(edges_middle(mesh, rims[0]))
    widest = f"the widest, {edges_width(mesh, rims[0]):.4f} m, at {where}"
    return Mesh(np.concatenate(vertices), np.concatenate(faces)), f"{len(rims)} holes filled, {widest}"


def _is_flat(mesh: Mesh, rim: Numbers) -> bool:
    """Return whether a rim (k, 2) is flat, and nearly all of it is seen from its middle."""
    middle = mesh.vertices[rim[:, 0]].mean(axis=0)
    ends = mesh.vertices[rim] - middle
    normal = np.linalg.svd(ends[:, 0], full_matrices=False)[2][-1]
    turns = np.cross(ends[:, 0], ends[:, 1]) @ normal
    is_star = abs(turns.sum()) > (1 - 2 * FOLDED) * np.abs(turns).sum()
    return bool(is_star) and float(np.ptp(ends[:, 0] @ normal)) <= FLAT * edges_width(mesh, rim)


def largest_body(mesh: Mesh) -> tuple[Mesh, str]:
    """Keep the body whose corners are spread most in space alone."""
    mesh = merge_vertices(mesh)[0]
    labels, corners = bodies(mesh), mesh.corners
    found = np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels))[:-1])
    kept = max(found, key=lambda faces: float(np.linalg.det(np.cov(corners[faces].reshape(-1, 3).T))))
    used, faces = np.unique(mesh.faces[kept], return_inverse=True)
    words = f"the largest of {len(found)} bodies kept" if len(found) > 1 else ""
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3)), words


MEETING = 1e-3  # Bodies with no larger distance than this belong together [m]
GAP_POINTS = 100_000  # Points of the surface that stand for the bodies, besides all vertices
ASIDE = 1e-5  # Distance from its surface at which a body is looked for in others [m]


def body_gap(mesh: Mesh) -> float:
    """Return the distance [m] from the first body, and all connected to it, to the others.

    0 where all bodies meet: their surfaces come near each other, or one is in the material of another, as a
    hollow is. Surfaces are compared by points on them, so that the distance may be a little more.
    """
    from scipy.spatial import KDTree

    labels = bodies(mesh)
    if not labels.any():
        return 0.0
    holders = _holders(mesh, labels)
    pieces = _connected(np.column_stack([np.arange(len(holders)), holders]), len(holders))[labels]
    sampled, drawn = sample_surface(mesh, GAP_POINTS, seed=0)
    corners, first = np.unique(mesh.faces, return_index=True)
    points = np.concatenate([sampled, mesh.vertices[corners]])
    owners = np.concatenate([pieces[drawn], pieces[first // 3]])
    near = MEETING + 2 * np.sqrt(mesh.areas.sum() / GAP_POINTS)  # hardly a point has a wider gap around it
    is_new, away = owners == pieces[0], np.full(len(points), np.inf)
    left = ~is_new
    while is_new.any() and left.any():
        away[left] = np.minimum(away[left], KDTree(points[is_new]).query(points[left])[0])
        is_new = np.isin(owners, owners[left & (away <= near)])
        left &= ~is_new
    return float(away.min(where=left, initial=np.inf)) if left.any() else 0.0


def _holders(mesh: Mesh, labels: Numbers) -> Numbers:
    """Return the innermost body (b,) in whose material each body lies; itself if in no other."""
    volumes = np.bincount(labels, weights=mesh.cone_volumes)
    order = np.lexsort((-mesh.areas, labels))
    largest = order[np.searchsorted(labels[order], np.arange(len(volumes)))]  # triangle of each body
    outward = np.sign(volumes)[:, None] * mesh.normals[largest]  # a hollow is left into the material
    points = mesh.corners[largest].mean(axis=1) + ASIDE * outward
    holders = np.arange(len(volumes))
    held = np.flatnonzero(inside_count(mesh, points) > 0)
    for body in np.argsort(-volumes)[: (volumes > 0).sum()] if len(held) else ():
        part = Mesh(mesh.vertices, mesh.faces[labels == body])
        holders[held[inside_count(part, points[held]) > 0]] = body
    return holders


CELLS = 96  # Cells of the lattice along the largest side
OFFSET = 0.8  # Distance of the surface that is looked for from what there is [cells]
KEPT_OFFSET = 0.25  # Distance at which it then stands, half the thickness that a sheet gets [cells]
SAMPLE_SPACING = 0.33  # Mean distance of the points that stand for what there is [cells]
MOST_SAMPLES = 4_000_000
MARGIN = 3  # Cells around the mesh
MOST_GROWTH = 0.05  # Largest relative growth of the volume of a closed mesh by a new surface
REMESHED_TRIANGLES = 20_000  # Triangles of a new surface unless other numbers are asked for


def prepare_mesh(mesh: Mesh, preparation: MeshPreparation) -> tuple[Mesh, tuple[str, ...]]:
    """Return a mesh with the changes that are asked for, and these in words.

    The mesh need not be closed unless it is only simplified. Raises `AssetError` if it has no hull, or a new
    surface would enclose another volume.
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
        before, volume = len(mesh.faces), mesh.volume if is_surface(mesh) else np.inf
        mesh = remesh(mesh)
        if mesh.volume > (1 + MOST_GROWTH) * volume:  # where bodies overlap, it was counted twice before
            raise AssetError(
                f"a new surface would enclose {mesh.volume / volume:.2f} times its volume, as walls or gaps "
                "are of the size of its cells: leave --mesh remesh out, or take hull"
            )
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

    occupied = np.zeros(shape, dtype=bool)
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
    points, cells, faces = [], [], []
    for axis in range(3):
        step, across, along = np.roll(np.eye(3, dtype=int), -axis, axis=0)
        here = np.moveaxis(field < 0, axis, 0)
        ends = np.argwhere(np.moveaxis(here[:-1] != here[1:], 0, axis))
        low, high = field[tuple(ends.T)], field[tuple((ends + step).T)]
        places = (ends, ends - across, ends - across - along, ends - along)
        around = [np.ravel_multi_index(tuple(place.T), field.shape) for place in places]
        a, b, c, d = around
        b, d = np.where(low < 0, b, d), np.where(low < 0, d, b)
        faces += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
        points.append(np.tile(ends + (low / (low - high))[:, None] * step, (4, 1)))
        cells += around
    found, numbers = np.unique(np.concatenate(cells), return_inverse=True)
    sums = [np.bincount(numbers, weights=column) for column in np.concatenate(points).T]
    return np.stack(sums, axis=1) / np.bincount(numbers)[:, None], np.searchsorted(
        found, np.concatenate(faces)
    )
