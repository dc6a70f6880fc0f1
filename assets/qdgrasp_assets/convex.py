"""Convex parts of a mesh: as few as leave a finger the room that it has in front of the mesh itself.

One hull where that will do, else what CoACD finds, coarse to fine; kept on disk
(docs/decisions/0008-collision-decomposition.md).
"""

import hashlib
import logging
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from qdgrasp_assets import room
from qdgrasp_assets.decompose import CORNERS, ITERATIONS, TOLERANCE, TookTooLong, decompose, simple
from qdgrasp_assets.files import cache_folder
from qdgrasp_assets.kept_parts import keep, make_folder, read_kept
from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.solids import hull
from qdgrasp_assets.room import Room

log = logging.getLogger(__name__)

THRESHOLDS = (0.1, 0.05, 0.025)
"""CoACD's concavities in the order in which they are tried: the first whose parts fit is taken."""
TIME_LIMIT = 1200.0  # s, for all of them; a scan of 16 000 triangles takes some minutes
Tell = Callable[[str], None]
_unfinished: dict[str, tuple[Mesh, ...]] = {}
"""What was found of meshes before time ran out: this process takes it again, and others try anew."""


def quietly(_sentence: str) -> None:
    """Hear what is told, and say nothing."""


def convex_parts(
    mesh: Mesh, name: str, time_limit: float = TIME_LIMIT, tell: Tell = quietly
) -> tuple[Mesh, ...]:
    """Convex parts that together stand for a mesh, in its frame; the same mesh gives the same parts.

    Where no parts fit, or time runs out, the finest there are are taken, with a warning. Those for which time
    ran out are not kept on disk.

    Parameters
    ----------
    mesh
        A closed surface [m]; one or several bodies.
    name
        How errors and the progress sentence call it.
    time_limit
        How long CoACD may take [s].
    tell
        Hears what is tried, each time that something else is.

    Raises
    ------
    AssetError
        CoACD failed, or found nothing in time; or the parts cannot be kept.
    """
    return collision_parts(mesh, name, time_limit, tell)[1]


def collision_parts(
    mesh: Mesh, name: str, time_limit: float = TIME_LIMIT, tell: Tell = quietly
) -> tuple[str, tuple[Mesh, ...]]:
    """Where the convex parts of a mesh come from, "own hull" or "coacd", and the parts of `convex_parts`."""
    known = _known(mesh)
    if known is None and is_convex(mesh):
        return "own hull", (_own(mesh),)
    return "coacd", _found(mesh, name, time_limit, tell) if known is None else known


def parts_at_hand(mesh: Mesh) -> tuple[Mesh, ...] | None:
    """What `convex_parts` gives, where that takes no time; None where CoACD has not run yet."""
    known = _known(mesh)
    return (_own(mesh),) if known is None and is_convex(mesh) else known


def _known(mesh: Mesh) -> tuple[Mesh, ...] | None:
    """What CoACD found before; None: it has not run."""
    kept = read_kept(_cached(mesh))
    return _unfinished.get(_key(mesh)) if kept is None else kept


def _own(mesh: Mesh) -> Mesh:
    """The hull of a mesh that is convex."""
    return simple(hull(mesh.vertices))


def _found(mesh: Mesh, name: str, time_limit: float, tell: Tell) -> tuple[Mesh, ...]:
    """What CoACD finds, kept for the next time."""
    cached = _cached(mesh)
    log.warning(
        "Decomposing '%s' (%d triangles) into convex parts, once%s; this takes up to a few minutes.",
        name,
        len(mesh.faces),
        f" again, as '{cached}' does not hold them whole" if cached.exists() else "",
    )
    make_folder(cached.parent, name)
    parts, is_final = _coarsest(mesh, name, time_limit, tell)
    if not is_final:
        return _unfinished.setdefault(_key(mesh), parts)
    return keep(parts, cached, name)


def is_convex(mesh: Mesh) -> bool:
    """Whether a mesh is convex as far as a finger can tell: its hull leaves the same room."""
    return Room(mesh).fit((hull(mesh.vertices),)).is_good


def _coarsest(mesh: Mesh, name: str, time_limit: float, tell: Tell) -> tuple[tuple[Mesh, ...], bool]:
    """The fewest parts that fit, or the last that were found; and whether there was time for all."""
    space, deadline = Room(mesh), time.monotonic() + time_limit
    found: tuple[Mesh, ...] = ()
    for turn, threshold in enumerate(THRESHOLDS, start=1):
        tell(f"convex parts with a concavity of {threshold:g} ({turn} of at most {len(THRESHOLDS)})")
        try:
            found = decompose(mesh, name, threshold, deadline - time.monotonic())
        except TookTooLong:
            if not found:
                raise TookTooLong(name, time_limit) from None
            _warn(name, found, space, "there was no time for finer ones, which the next command tries again")
            return found, False
        if space.fit(found).is_good:
            return found, True
    _warn(name, found, space, "finer ones are not tried")
    return found, True


def _warn(name: str, parts: tuple[Mesh, ...], space: Room, reason: str) -> None:
    """Say what parts that do not fit do to grasps, and why there are no finer ones."""
    fit = space.fit(parts)
    log.warning(
        "The %d convex parts of '%s' fill the room in front of %.0f %% of its surface, and leave %.0f %% "
        "of it out, where grasps may be lost; %s.",
        len(parts),
        name,
        100 * fit.filled,
        100 * fit.bare,
        reason,
    )


def _cached(mesh: Mesh) -> Path:
    """Where the parts of this mesh are kept once they are found."""
    return cache_folder() / "convex" / f"{_key(mesh)}.obj"


def _key(mesh: Mesh) -> str:
    """Names a decomposition: of this mesh, by this version, with this rule."""
    rule = (THRESHOLDS, ITERATIONS, TOLERANCE, CORNERS, room.POINTS, room.AHEAD, room.OFF, room.MOST)
    geometry = mesh.vertices.astype("<f8").tobytes() + mesh.faces.astype("<u4").tobytes()
    return hashlib.sha256(f"coacd {version('coacd')} {rule}".encode() + geometry).hexdigest()
