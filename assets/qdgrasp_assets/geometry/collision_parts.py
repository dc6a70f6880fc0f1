"""Convex collision parts of a mesh: as few as leave a finger its clearance.

One hull where that will do, else what CoACD finds, coarse to fine
(docs/decisions/0008-collision-decomposition.md). A finger cannot reach space that the parts fill beyond the
mesh: most grasps of a mug need its hollow and the eye of its handle. CoACD runs in a process of its own,
which can be given up; run as a module (`python -m qdgrasp_assets.geometry.collision_parts IN.npz
THRESHOLD OUT.obj [SECONDS MEMORY]`) this is that process. Where it has limits, and cannot keep them, coarser
parts are taken (`limited_parts`).

Parts are cached on disk: an OBJ file that ends with the digest of what stands before, or counts as none.
The last line is a remark, which readers of OBJ files leave aside.
"""

import hashlib
import logging
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.asset_paths import cache_folder, path_problem, write_whole
from qdgrasp_assets.geometry.mesh import Floats, Mesh, parts_to_obj, read_parts
from qdgrasp_assets.geometry.primitives import heights, hull
from qdgrasp_assets.geometry.proximity import inside_count, ray_distance
from qdgrasp_assets.geometry.remesh import simplify_mesh
from qdgrasp_assets.geometry.surface_points import sample_surface
from qdgrasp_assets.process_limits import limit_memory
from qdgrasp_protocol.errors import AssetError

CLEARANCE_POINTS = 10_000
AHEAD = 3e-3  # Distance in front of the surface at which free space is checked [m]
CLEAR = 2 * AHEAD  # Least free distance in front [m]: no finger enters a narrower gap
OFF = 2e-3  # Largest distance of a part's surface behind the mesh's [m]
LIFT = 1e-6  # Offset above the surface at which rays begin, so that they do not meet it again [m]
OUT = 1e-5  # Offset in front of the surface of the points tested for being inside [m]
FEW = 1e-3  # Share of the surface that seems to be inside below which it is rounding
PAIRS = 1 << 26  # Pairs of point and face that are compared at once: half a gigabyte
MANY_FACES = 20_000
"""Faces of a convex part above which points are compared with some of them first.

Only hulls of dense round meshes have so many; what is found is the same.
"""
SOME_FACES = 500  # Faces that are compared first: those of a ball leave out most points before it
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
    if len(part.faces) > MANY_FACES:
        some = Mesh(part.vertices, part.faces[:: len(part.faces) // SOME_FACES])
        within[within] = (heights(some, points[within]) <= margin).all(axis=1)
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


class DecompositionTimeout(AssetError):
    """Error of CoACD when it does not finish in time."""

    def __init__(self, name: str, seconds: float) -> None:
        super().__init__(
            f"CoACD did not decompose the mesh '{name}' into convex parts within {seconds:g} s; simplify the "
            "mesh, for example to 20 000 triangles."
        )


class DecompositionFailure(AssetError):
    """Error of CoACD when it ends without parts; `last` is the end of what it says."""

    def __init__(self, name: str, exit_code: int, last: str) -> None:
        super().__init__(
            f"CoACD could not decompose the mesh '{name}' into convex parts (exit code {exit_code}): "
            f"{last or 'it says nothing'}."
        )
        self.is_of_memory = any(words in last for words in OUT_OF_MEMORY)
        """True if there was not enough memory for it."""


@dataclass(frozen=True)
class ProcessLimits:
    """Limits of one process of CoACD."""

    seconds: float
    """Most CPU time [s]."""
    memory: int
    """Most memory [bytes]."""


OUT_OF_MEMORY = ("MemoryError", "bad_alloc", "Cannot allocate memory")
"""Words with which a process ends that asked for more memory than it may have."""
PATIENCE = 30  # Multiple of its limit of CPU time that a process may take by the clock


def decompose(
    mesh: Mesh, name: str, threshold: float, time_limit: float, limits: ProcessLimits | None = None
) -> tuple[Mesh, ...]:
    """Decompose a mesh into convex parts that together fill it, with few corners each.

    They are in the mesh's frame. `mesh` is a closed surface [m], one or several bodies,
    called `name` in errors. `threshold` is CoACD's concavity: the smaller, the more parts. Raises
    `DecompositionTimeout` after `time_limit` [s] by the clock, or past the limit of CPU time, and
    `AssetError` if CoACD fails.
    """
    if _is_dense(mesh):
        mesh = simplify_mesh(mesh, COACD_TRIANGLES)
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as folder:
        given, found = Path(folder) / "mesh.npz", Path(folder) / "parts.obj"
        np.savez(given, vertices=mesh.vertices, faces=mesh.faces)
        command = [sys.executable, "-m", __spec__.name, str(given), str(threshold), str(found)]
        if limits is not None:
            command += [str(math.ceil(limits.seconds)), str(limits.memory)]
        from qdgrasp_protocol.process import ONE_THREAD  # it imports structlog, which no simulator loads

        environment = os.environ if limits is None else os.environ | ONE_THREAD
        pipe, null = subprocess.PIPE, subprocess.DEVNULL
        with (
            tempfile.TemporaryFile() as errors,  # not a pipe, which would fill while it is not read
            subprocess.Popen(command, stdin=pipe, stdout=null, stderr=errors, env=environment) as process,
        ):
            try:
                process.wait(max(0.0, time_limit))
            except subprocess.TimeoutExpired:
                raise DecompositionTimeout(name, time_limit) from None
            finally:
                process.kill()
            if process.returncode == -signal.SIGXCPU:
                raise DecompositionTimeout(name, time_limit if limits is None else limits.seconds)
            if process.returncode:
                errors.seek(0)
                last = " ".join(errors.read().decode(errors="replace").split())[-200:]
                raise DecompositionFailure(name, process.returncode, last)
        if not found.is_file():
            raise AssetError(f"CoACD found no convex parts of the mesh '{name}'.")
        return read_parts(found)


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
    """Decompose the mesh in the first file into the last; exit when the parent process is gone."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if limits := [int(number) for number in sys.argv[4:]]:
        resource.setrlimit(resource.RLIMIT_CPU, (limits[0], limits[0] + 1))
        limit_memory(limits[1])
    import coacd

    coacd.set_log_level("error")
    given = np.load(sys.argv[1], allow_pickle=False)
    mesh = coacd.Mesh(given["vertices"], given["faces"])
    found = coacd.run_coacd(mesh, threshold=float(sys.argv[2]), mcts_iterations=COACD_ITERATIONS, seed=0)
    Path(sys.argv[3]).write_bytes(parts_to_obj(solid_parts(points for points, _ in found)))


def solid_parts(found: Iterable[ArrayLike]) -> Iterator[Mesh]:
    """Yield the hulls of parts (v, 3) [m], with few corners each, and none of flat parts."""
    from scipy.spatial import QhullError

    for points in found:
        with suppress(QhullError):
            yield simplify_part(hull(np.asarray(points, dtype=np.float64)))


def _end_with_parent() -> None:
    """Exit once standard input, whose other end the parent process holds, is closed."""
    while os.read(0, 1024):
        pass
    os._exit(1)


log = logging.getLogger(__name__)

COACD_THRESHOLDS = (0.1, 0.05, 0.025)
"""Concavities for CoACD, in the order tried: the first whose parts fit is taken."""
TIME_LIMIT = 1200.0  # s, for all of them; a scan of 16 000 triangles takes some minutes
OWN_HULL, COACD = "own hull", "coacd"  # Sources of parts
Tell = Callable[[str], None]
_unfinished: dict[str, tuple[Mesh, ...]] = {}
"""Parts of meshes for which time ran out, by key; valid in this process only, not on disk."""


def ignore_progress(_sentence: str) -> None:
    """Ignore a progress message."""


def collision_parts(
    mesh: Mesh, name: str, time_limit: float = TIME_LIMIT, tell: Tell = ignore_progress
) -> tuple[str, tuple[Mesh, ...]]:
    """Return the source, "own hull" or "coacd", and the convex parts that stand for a mesh.

    `mesh` is a closed surface [m], one or several bodies, called `name` in messages. The parts are in its
    frame, and deterministic. Where none fit, or CoACD's `time_limit` [s] runs out, the finest that were found
    are taken, with a warning; those for which time ran out are not kept on disk. `tell` is called with a
    sentence before each attempt. Raises `AssetError` if CoACD failed, or found nothing in time; or the parts
    cannot be kept.
    """
    known = _known_parts(mesh)
    if known is not None:
        return known
    cached = _cache_file(mesh)
    log.warning(
        "Decomposing '%s' (%d triangles) into convex parts, once%s; this takes up to a few minutes.",
        name,
        len(mesh.faces),
        f" again, as '{cached}' does not hold them whole" if cached.exists() else "",
    )
    with _keeping(cached.parent, name):
        cached.parent.mkdir(parents=True, exist_ok=True)
    parts, is_final = _coarsest_parts(mesh, name, time_limit, tell)
    if not is_final:
        return COACD, _unfinished.setdefault(_cache_key(mesh), parts)
    content = parts_to_obj(parts)
    with _keeping(cached.parent, name):
        write_whole(cached, content + _digest_line(content), is_synced=True)
    return COACD, read_parts(cached)


def has_unfinished_parts(mesh: Mesh) -> bool:
    """Return whether time ran out in this process for finer parts of a mesh."""
    return _cache_key(mesh) in _unfinished


def limited_parts(mesh: Mesh, limits: ProcessLimits) -> tuple[str, tuple[Mesh, ...], PartsFit]:
    """Return the source, the convex parts that are found within limits, and their fit.

    They follow from the mesh alone, nothing is cached, and are those of `collision_parts` unless the limits
    leave no time for all attempts, or CoACD fails: then the finest that were found, else the own hull, and
    the source says so.
    """
    space = FingerClearance(mesh)
    source, parts = _parts_in_space(mesh, space, limits)
    return source, parts, space.fit(parts)


def _parts_in_space(
    mesh: Mesh, space: FingerClearance, limits: ProcessLimits
) -> tuple[str, tuple[Mesh, ...]]:
    own, found = hull(mesh.vertices), tuple[Mesh, ...]()
    if space.is_convex(own):
        return OWN_HULL, (simplify_part(own),)
    left = limits.seconds
    for threshold in COACD_THRESHOLDS:
        spent = _children_seconds()
        try:
            if left <= 0:
                raise DecompositionTimeout("", limits.seconds)
            found = decompose(mesh, "", threshold, PATIENCE * left, ProcessLimits(left, limits.memory))
        except AssetError as error:
            if found:
                return f"{COACD}, coarse: finer parts {_reason(error, limits)}", found
            return f"{OWN_HULL}: CoACD {_reason(error, limits)}", (simplify_part(own),)
        if space.fit(found).is_good:
            break
        left -= _children_seconds() - spent
    return COACD, found


def _is_dense(mesh: Mesh) -> bool:
    return len(mesh.faces) > COACD_TRIANGLES


def _reason(error: AssetError, limits: ProcessLimits) -> str:
    """Return why CoACD found no parts, as the end of a sentence."""
    if isinstance(error, DecompositionTimeout):
        return f"took more than {limits.seconds:g} s"
    if isinstance(error, DecompositionFailure) and error.is_of_memory:
        return f"took more than {limits.memory / 1e9:.1f} GB"
    return "failed"


def _children_seconds() -> float:
    """Return the CPU time of all child processes that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def available_parts(mesh: Mesh) -> tuple[Mesh, ...] | None:
    """Return the parts of `collision_parts` if that takes no time; None: CoACD has not run yet."""
    known = _known_parts(mesh)
    return None if known is None else known[1]


def _known_parts(mesh: Mesh) -> tuple[str, tuple[Mesh, ...]] | None:
    """Return source and parts that CoACD need not run for: found before, or the mesh's own hull."""
    file, key = _cache_file(mesh), _cache_key(mesh)
    if not path_problem(file) and _is_whole(file):
        return COACD, read_parts(file)
    if key in _unfinished:
        return COACD, _unfinished[key]
    own = hull(mesh.vertices)
    # convex for a finger: the hull leaves the same free space
    return (OWN_HULL, (simplify_part(own),)) if FingerClearance(mesh).is_convex(own) else None


def _coarsest_parts(mesh: Mesh, name: str, time_limit: float, tell: Tell) -> tuple[tuple[Mesh, ...], bool]:
    """Return the fewest parts that fit, or the last found; and whether there was time for all."""
    space, deadline = FingerClearance(mesh), time.monotonic() + time_limit
    found: tuple[Mesh, ...] = ()
    is_final, reason = True, "finer ones are not tried"
    for number, threshold in enumerate(COACD_THRESHOLDS, start=1):
        tell(
            f"splitting {name} into convex parts with a concavity of {threshold:g} ({number} of at most "
            f"{len(COACD_THRESHOLDS)} tries)"
        )
        try:
            found = decompose(mesh, name, threshold, deadline - time.monotonic())
        except DecompositionTimeout:
            if not found:
                raise DecompositionTimeout(name, time_limit) from None
            is_final, reason = False, "there was no time for finer ones, which the next command tries again"
            break
        if space.fit(found).is_good:
            return found, True
    fit = space.fit(found)
    log.warning(
        "The %d convex parts of '%s' fill the room in front of %.0f %% of its surface, and leave %.0f %% "
        "of it out, where grasps may be lost; %s.",
        len(found),
        name,
        100 * fit.filled,
        100 * fit.bare,
        reason,
    )
    return found, is_final


@contextmanager
def _keeping(folder: Path, name: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise AssetError(
            f"The convex parts of '{name}' cannot be kept in '{folder}': {error.strerror or error}; "
            "name another folder with QDGRASP_CACHE."
        ) from None


def _digest_line(content: bytes) -> bytes:
    """Return the last line of a cached file: the digest of the lines before."""
    return f"# sha256 {hashlib.sha256(content).hexdigest()}\n".encode()


def _is_whole(file: Path) -> bool:
    try:
        content = file.read_bytes()
    except OSError:
        return False
    start = content.rfind(b"#")
    return start > 0 and content[start:] == _digest_line(content[:start])


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
