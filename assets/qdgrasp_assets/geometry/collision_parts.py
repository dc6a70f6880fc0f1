"""Convex collision parts of a mesh: as few as leave a finger its clearance.

One hull where that will do, else what CoACD finds, coarse to fine
(docs/decisions/0008-collision-decomposition.md). A finger cannot reach space that the parts fill beyond the
mesh: most grasps of a mug need its hollow and the eye of its handle. The parts follow from the mesh alone,
and are cached on disk as an OBJ file.

CoACD runs in a process of its own, which has a limit of CPU time and can be ended; run as a module
(`python -m qdgrasp_assets.geometry.collision_parts IN.npz THRESHOLD OUT.obj`) this is that process.
"""

import hashlib
import logging
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.asset_paths import cache_folder, path_problem, write_whole
from qdgrasp_assets.geometry.mesh import Floats, Mesh, heights, hull, parse_parts, parts_to_obj, read_parts
from qdgrasp_assets.geometry.mesh_repair import simplify_mesh
from qdgrasp_assets.geometry.proximity import inside_count, ray_distance
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_assets.process_limits import end_with_parent_only
from qdgrasp_protocol.errors import AssetError, UnreadableHere

CLEARANCE_POINTS = 10_000
AHEAD = 3e-3  # Distance in front of the surface at which free space is checked [m]
CLEAR = 2 * AHEAD  # Least free distance in front [m]: no finger enters a narrower gap
OFF = 2e-3  # Largest distance of a part's surface behind the mesh's [m]
LIFT = 1e-6  # Offset above the surface at which rays begin, so that they do not meet it again [m]
OUT = 1e-5  # Offset in front of the surface of the points tested for being inside [m]
FEW = 1e-3  # Share of the surface that seems to be inside below which it is rounding
PAIRS = 1 << 26  # Pairs of point and face that are compared at once: half a gigabyte
MOST = 0.01  # Largest share of the surface that is wrong in a good fit; a mug's handle, filled: 2 %


@dataclass(frozen=True)
class PartsFit:
    """Quality of convex parts as a stand-in for a mesh, in shares of its surface."""

    filled: float
    """Share in front of which the parts fill free space."""
    bare: float
    """Share that is outside all parts."""

    @property
    def is_good(self) -> bool:
        """True if the parts change few outcomes."""
        return max(self.filled, self.bare) <= MOST


class FingerClearance:
    """The free space in front of the surface of a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._points, drawn = sample_surface(mesh, CLEARANCE_POINTS, seed=0)
        self._normals = mesh.normals[drawn]

    def fit(self, parts: tuple[Mesh, ...]) -> PartsFit:
        """Return the fit of convex `parts`, in the frame of the mesh."""
        filled = self._is_filled(parts)
        covered = np.any([is_within(part, self._points, OFF) for part in parts], axis=0)
        return PartsFit(float(filled.mean()) if len(filled) else 0.0, float(1.0 - covered.mean()))

    def is_convex(self, own: Mesh) -> bool:
        """Return whether the mesh's hull, outside which nothing lies, leaves a finger its room."""
        filled = self._is_filled((own,))
        return not len(filled) or float(filled.mean()) <= MOST

    def _is_filled(self, parts: tuple[Mesh, ...]) -> NDArray[np.bool_]:
        filled: NDArray[np.bool_] = np.any(
            [is_within(part, self._clear_points, 0.0) for part in parts], axis=0
        )
        return filled

    @property
    def inside(self) -> float:
        """Share of the surface that is inside the mesh, where it cuts itself or bodies overlap."""
        share = float(self._inside.mean())
        return share if share > FEW else 0.0

    @cached_property
    def _inside(self) -> NDArray[np.bool_]:
        """(n,): True for points that have the mesh's inside in front of them."""
        return inside_count(self._mesh, self._points + OUT * self._normals, self._normals) > 0

    @cached_property
    def _clear_points(self) -> Floats:
        """Points (n, 3) [m], `AHEAD` in front of the surface, in free space."""
        clear = ray_distance(self._mesh, self._points + LIFT * self._normals, self._normals) > CLEAR
        if self.inside:
            clear &= ~self._inside
        return self._points[clear] + AHEAD * self._normals[clear]


def is_within(part: Mesh, points: Floats, margin: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the points within `margin` [m] of a convex part, by its planes."""
    low, high = part.bounds
    within: NDArray[np.bool_] = np.all((points >= low - margin) & (points <= high + margin), axis=1)
    near = points[within]
    rows = max(1, PAIRS // len(part.faces))
    blocks = [near[start : start + rows] for start in range(0, len(near), rows)] or [near]
    within[within] = np.concatenate([(heights(part, block) <= margin).all(axis=1) for block in blocks])
    return within


CORNER_TOLERANCE = 5e-4  # A corner that is not farther outside the hull of others is left out [m]
MOST_CORNERS = 128  # Most corners of a part
COACD_ITERATIONS = 50
"""Iterations of CoACD's search per cut; its own 150 take half as long again, parts no fewer."""
COACD_TRIANGLES = 30_000
"""Most triangles that CoACD is given: a denser mesh, which takes it minutes, is simplified for it."""
CORNERS_AT_ONCE = 1 << 17
"""Corners compared at once: their distances from the faces of the hull fill some 300 MB."""
MANY_CORNERS, SHARE = 20_000, 32
"""Corners of a part above which one in so many is looked at first: the search takes as long as there are."""
OUTWARD_DIRECTIONS = np.array([*np.eye(3), *-np.eye(3), *product((-1.0, 1.0), repeat=3)])
"""The directions in which a part keeps its extent, in the unit cube."""
COACD_SECONDS = 1800
"""Most CPU time of CoACD for a mesh at one concavity [s]; a scan of 16 000 triangles takes some minutes."""


def decompose(mesh: Mesh, name: str, threshold: float) -> tuple[Mesh, ...]:
    """Decompose a mesh into convex parts that together fill it, with few corners each.

    They are in the mesh's frame. `mesh` is a closed surface [m], one or several bodies,
    called `name` in errors. `threshold` is CoACD's concavity: the smaller, the more parts. Raises
    `AssetError` if CoACD fails, or takes more than `COACD_SECONDS`.
    """
    if _is_dense(mesh):
        mesh = simplify_mesh(mesh, COACD_TRIANGLES)
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as folder:
        given, found = Path(folder) / "mesh.npz", Path(folder) / "parts.obj"
        np.savez(given, vertices=mesh.vertices, faces=mesh.faces)
        command = [sys.executable, "-m", __spec__.name, str(given), str(threshold), str(found)]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
        if done.returncode:
            raise _failure(name, done.returncode, done.stderr)
        return parse_parts(found.read_text())


def _failure(name: str, code: int, said: bytes) -> AssetError:
    """Return the error of CoACD that ended with an exit code, and last said this."""
    if code == -signal.SIGXCPU:
        return AssetError(
            f"CoACD did not decompose the mesh '{name}' into convex parts within {COACD_SECONDS} s of CPU "
            "time; simplify the mesh, for example to 20 000 triangles."
        )
    last = " ".join(said.decode(errors="replace").split())[-200:]
    # a signal is that of a machine that is short of memory
    return (AssetError if code > 0 else UnreadableHere)(
        f"CoACD could not decompose the mesh '{name}' into convex parts (exit code {code}): "
        f"{last or 'it says nothing'}."
    )


def simplify_part(part: Mesh) -> Mesh:
    """Simplify a convex part so that no corner left out is farther outside than the tolerance.

    Greedy: it begins with the corners that are farthest in a few directions, and adds the one that is
    farthest outside the hull so far, until all are within the tolerance, or it has `MOST_CORNERS`. Of very
    many corners it adds some of a share first, and then of all.
    """
    corners, kept = part.vertices, _outermost(part.vertices)
    shares = [slice(None)] if len(corners) <= MANY_CORNERS else [slice(0, None, SHARE), slice(None)]
    for share in shares:
        found = _add_corners(corners, np.arange(len(corners))[share], kept)
    return found


def _add_corners(corners: Floats, some: NDArray[np.int64], kept: list[int]) -> Mesh:
    """Add some of the corners to those kept, by their indices; return the hull of these."""
    starts = range(0, len(some), CORNERS_AT_ONCE)
    blocks = [corners[some[start : start + CORNERS_AT_ONCE]] for start in starts]
    while True:
        found = hull(corners[kept])
        outside = np.concatenate([heights(found, block).max(axis=1) for block in blocks])
        if outside.max() <= CORNER_TOLERANCE or len(kept) >= MOST_CORNERS:
            return found
        kept.append(int(some[outside.argmax()]))


def _outermost(corners: Floats) -> list[int]:
    """Return the indices of some outermost corners of a solid (v, 3), not all in one plane."""
    places = (corners / np.ptp(corners, axis=0) @ OUTWARD_DIRECTIONS.T).argmax(axis=0)
    some = corners[places]
    across = corners @ np.linalg.svd(some - some.mean(axis=0))[2][-1]
    return sorted({*places.tolist(), int(across.argmin()), int(across.argmax())})


def main() -> None:
    """Decompose the mesh in the first file into the last; end with the parent process."""
    end_with_parent_only()
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    with suppress(ValueError):  # a lower limit is set from outside
        resource.setrlimit(resource.RLIMIT_CPU, (COACD_SECONDS, most))
    import coacd

    coacd.set_log_level("error")
    given = np.load(sys.argv[1], allow_pickle=False)
    mesh = coacd.Mesh(given["vertices"], given["faces"])
    found = coacd.run_coacd(mesh, threshold=float(sys.argv[2]), mcts_iterations=COACD_ITERATIONS, seed=0)
    parts = tuple(solid_parts(points for points, _ in found))
    if not parts:
        sys.exit("it found no convex parts")
    Path(sys.argv[3]).write_bytes(parts_to_obj(parts))


def solid_parts(found: Iterable[ArrayLike]) -> Iterator[Mesh]:
    """Yield the hulls of parts (v, 3) [m], with few corners each, and none of flat parts."""
    from scipy.spatial import QhullError

    for points in found:
        with suppress(QhullError):
            yield simplify_part(hull(np.asarray(points, dtype=np.float64)))


log = logging.getLogger(__name__)

COACD_THRESHOLDS = (0.1, 0.05, 0.025)
"""Concavities for CoACD, in the order tried: the first whose parts fit is taken."""
OWN_HULL, COACD = "own hull", "coacd"  # Sources of parts
Tell = Callable[[str], None]


def ignore_progress(_sentence: str) -> None:
    """Ignore a progress message."""


def collision_parts(mesh: Mesh, name: str, tell: Tell = ignore_progress) -> tuple[str, tuple[Mesh, ...]]:
    """Return the source, "own hull" or "coacd", and the convex parts that stand for a mesh.

    `mesh` is a closed surface [m], one or several bodies, called `name` in messages. The parts are in its
    frame, and follow from the mesh alone. Where none fit, the finest are taken, with a warning. `tell` is
    called with a sentence before each attempt. Raises `AssetError` if CoACD failed, or took too long.
    """
    if known := known_parts(mesh):
        return known
    log.warning(
        "Decomposing '%s' (%d triangles) into convex parts, once; this takes up to a few minutes.",
        name,
        len(mesh.faces),
    )
    content = parts_to_obj(_coarsest_parts(mesh, name, tell))
    with suppress(OSError):  # they are found again where they cannot be kept
        write_whole(_cache_file(mesh), content, is_synced=True)
    return COACD, parse_parts(content.decode())


def known_parts(mesh: Mesh) -> tuple[str, tuple[Mesh, ...]] | None:
    """Return what `collision_parts` does if that takes no time; None: CoACD has not run yet."""
    if not path_problem(file := _cache_file(mesh)):
        return COACD, read_parts(file)
    own = hull(mesh.vertices)
    # convex for a finger: the hull leaves the same free space
    return (OWN_HULL, (simplify_part(own),)) if FingerClearance(mesh).is_convex(own) else None


def _coarsest_parts(mesh: Mesh, name: str, tell: Tell) -> tuple[Mesh, ...]:
    """Return the fewest parts that fit, or the last found."""
    space = FingerClearance(mesh)
    for number, threshold in enumerate(COACD_THRESHOLDS, start=1):
        tell(
            f"splitting {name} into convex parts with a concavity of {threshold:g} ({number} of at most "
            f"{len(COACD_THRESHOLDS)} tries)"
        )
        found = decompose(mesh, name, threshold)
        fit = space.fit(found)
        if fit.is_good:
            return found
    log.warning(
        "The %d convex parts of '%s' fill the room in front of %.0f %% of its surface, and leave %.0f %% "
        "of it out, where grasps may be lost; finer ones are not tried.",
        len(found),
        name,
        100 * fit.filled,
        100 * fit.bare,
    )
    return found


def _is_dense(mesh: Mesh) -> bool:
    return len(mesh.faces) > COACD_TRIANGLES


def _cache_file(mesh: Mesh) -> Path:
    return cache_folder() / "convex" / f"{_cache_key(mesh)}.obj"


def _cache_key(mesh: Mesh) -> str:
    """Return the cache key of a decomposition: of this mesh, by this version, with this rule."""
    decomposition = COACD_THRESHOLDS, COACD_ITERATIONS, CORNER_TOLERANCE, MOST_CORNERS
    simplified = (COACD_TRIANGLES,) if _is_dense(mesh) else ()
    rule = (*decomposition, CLEARANCE_POINTS, AHEAD, OFF, MOST, *simplified)
    geometry = mesh.vertices.astype("<f8").tobytes() + mesh.faces.astype("<u4").tobytes()
    return hashlib.sha256(f"coacd {version('coacd')} {rule}".encode() + geometry).hexdigest()


if __name__ == "__main__":
    main()
