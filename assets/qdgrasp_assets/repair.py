"""Repairs of a mesh that is no closed surface as it came: each changes what it must, and says so.

A mesh that is one already is left as it is, to the last bit: whatever was found with it is found again.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.rays import SKEW, within
from qdgrasp_assets.solidity import Edges, Numbers, bodies, body_volumes, middle, place, width

TOUCHING = 1e-5
"""Vertices that are nearer to each other than this share of the largest side are one."""
SMALL = 0.2
"""A hole up to this share of the largest side is filled where that is asked for."""


def repaired(mesh: Mesh, *, fill_holes: bool = False) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh as a closed surface wound outward, as far as that can be had, and what was done to it."""
    done = []
    for step in (merged, cleaned, wound, *((filled,) if fill_holes else ())):
        if is_surface(mesh):
            break
        mesh, words = step(mesh)
        done.append(words)
    if is_surface(mesh):
        mesh, words = turned(mesh)
        done.append(words)
    return mesh, tuple(words for words in done if words)


def is_surface(mesh: Mesh) -> bool:
    """Whether a mesh is closed and wound alike."""
    edges = Edges(mesh)
    return edges.is_closed and edges.is_wound_alike


def merged(mesh: Mesh) -> tuple[Mesh, str]:
    """Vertices that are all but at the same place as one: seams of textures, and of geometries, close."""
    places = np.round((mesh.vertices - mesh.vertices.min(axis=0)) / (TOUCHING * mesh.extents.max()))
    _, first, which = np.unique(places.astype(np.int64), axis=0, return_index=True, return_inverse=True)
    fewer = len(mesh.vertices) - len(first)
    if not fewer:
        return mesh, ""
    return Mesh(mesh.vertices[first], which.reshape(-1)[mesh.faces]), f"{fewer} vertices merged with others"


def cleaned(mesh: Mesh) -> tuple[Mesh, str]:
    """Without triangles of fewer than three corners, and with one of those that have the same corners.

    Two that lie back to back enclose nothing, and both go.
    """
    corners = np.sort(mesh.faces, axis=1)
    whole = np.flatnonzero((np.diff(corners, axis=1) > 0).all(axis=1))
    _, first, which = np.unique(corners[whole], axis=0, return_index=True, return_inverse=True)
    rising, which = _rising(mesh.faces[whole]), which.reshape(-1)
    up, down = (np.bincount(which, weights=way, minlength=len(first)) > 0 for way in (rising, ~rising))
    kept = np.sort(whole[first[up != down]])
    dropped = len(mesh.faces) - len(kept)
    if not dropped:
        return mesh, ""
    return Mesh(mesh.vertices, mesh.faces[kept]), f"{dropped} degenerate or duplicate triangles dropped"


def _rising(faces: Numbers) -> NDArray[np.bool_]:
    """(f,): whether a triangle's corners rise after its lowest one: two back to back differ in that."""
    rolled = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    rising: NDArray[np.bool_] = rolled[:, 1] < rolled[:, 2]
    return rising


def wound(mesh: Mesh) -> tuple[Mesh, str]:
    """Neighbours wound alike, each body as most of its triangles are."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges, count = Edges(mesh), len(mesh.faces)
    order = np.argsort(edges.which, kind="stable")
    paired = order[edges.times[edges.which[order]] == 2].reshape(-1, 2)
    one, other = paired.T % count
    alike = edges.directed[paired[:, 0], 0] != edges.directed[paired[:, 1], 0]
    # each triangle stands twice, as it is and turned; neighbours that fit are joined
    mate = np.where(alike, other, other + count)
    rows, columns = np.concatenate([one, one + count]), np.concatenate([mate, (mate + count) % (2 * count)])
    graph = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(2 * count, 2 * count))
    labels = connected_components(graph, directed=False)[1]
    votes = np.bincount(labels[:count], minlength=labels.max() + 1)
    as_is, as_turned = votes[labels[:count]], votes[labels[count:]]
    is_turned = (as_turned > as_is) | ((as_turned == as_is) & (labels[count:] < labels[:count]))
    is_turned &= labels[:count] != labels[count:]
    return _with_turned(mesh, is_turned, "wound like their neighbours")


def turned(mesh: Mesh) -> tuple[Mesh, str]:
    """Bodies that are inside out, turned."""
    labels, wrong = bodies(mesh), inverted(mesh)
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


def inverted(mesh: Mesh) -> NDArray[np.bool_]:
    """(b,): which bodies of a mesh have a negative volume and are no hollow within another one."""
    wrong: NDArray[np.bool_] = body_volumes(mesh) < 0
    for body in np.flatnonzero(wrong).tolist() if len(wrong) > 1 else ():
        wrong[body] = not _is_within_another(mesh, bodies(mesh), body)
    return wrong


def _is_within_another(mesh: Mesh, labels: Numbers, body: int) -> bool:
    others = Mesh(mesh.vertices, mesh.faces[labels != body])
    point = mesh.corners[np.flatnonzero(labels == body)[0]].mean(axis=0)
    return bool(within(others, point[None], SKEW[None])[0] > 0)


def filled(mesh: Mesh) -> tuple[Mesh, str]:
    """Small holes closed with a fan of triangles around the middle of their rim."""
    edges, limit = Edges(mesh), SMALL * mesh.extents.max()
    rims = [hole for hole in edges.holes if width(mesh, hole) <= limit and _is_ring(hole)]
    if not rims:
        return mesh, ""
    vertices, faces = [mesh.vertices], [mesh.faces]
    for number, rim in enumerate(rims):
        vertices.append(mesh.vertices[rim[:, 0]].mean(axis=0)[None])
        centre = np.full(len(rim), len(mesh.vertices) + number)
        faces.append(np.stack([rim[:, 1], rim[:, 0], centre], axis=1))
    where = place(middle(mesh, rims[0]))
    widest = f"the widest, {width(mesh, rims[0]):.4f} m, at {where}"
    return Mesh(np.concatenate(vertices), np.concatenate(faces)), f"{len(rims)} holes filled, {widest}"


def _is_ring(rim: Numbers) -> bool:
    """Whether edges (k, 2) go round once."""
    starts, ends = np.sort(rim[:, 0]), np.sort(rim[:, 1])
    return bool((starts == ends).all() and (np.diff(starts) > 0).all())
