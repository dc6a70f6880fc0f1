"""Convex parts of a mesh: one hull where it is convex, else CoACD in a process of its own, cached on disk.

Run as a module (`python -m qdgrasp_assets.convex IN.npz OUT.obj`) this is that process.
"""

import hashlib
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
from importlib.metadata import version
from pathlib import Path

import numpy as np

from qdgrasp_assets.files import cache_folder
from qdgrasp_assets.mesh import Floats, Mesh, parts_to_obj, read_parts
from qdgrasp_assets.objects.solids import geodesic, hull
from qdgrasp_protocol.errors import AssetError

log = logging.getLogger(__name__)

THRESHOLD = 0.025
"""CoACD's concavity; with 0.05 and more the handle of a mug is filled and half of its grasps are lost."""
TIME_LIMIT = 1200.0  # s; a scan of 16 000 triangles takes 2 to 6 minutes
CONVEX = 0.999  # a mesh that fills this share of its hull is convex
FREQUENCY = 3  # a part keeps at most the support points of geodesic(3): 92


def convex_parts(mesh: Mesh, name: str, time_limit: float = TIME_LIMIT) -> tuple[Mesh, ...]:
    """Convex parts that together fill the mesh, in its frame; the same mesh gives the same parts.

    Parameters
    ----------
    mesh
        A closed surface [m]; one or several bodies.
    name
        How errors and the progress sentence call it.
    time_limit
        How long CoACD may take [s].

    Raises
    ------
    AssetError
        CoACD failed or took too long.
    """
    if is_convex(mesh):
        return (simple(hull(mesh.vertices)),)
    cached = _cached(mesh)
    if not cached.is_file():
        log.warning(
            "Decomposing '%s' (%d triangles) into convex parts, once; this takes up to a few minutes.",
            name,
            len(mesh.faces),
        )
        _decompose(mesh, name, cached, time_limit)
    return read_parts(cached)


def collision_parts(mesh: Mesh, name: str) -> tuple[str, tuple[Mesh, ...]]:
    """Where the convex parts of a mesh come from, "own hull" or "coacd", and the parts."""
    return "own hull" if is_convex(mesh) else "coacd", convex_parts(mesh, name)


def parts_at_hand(mesh: Mesh) -> tuple[Mesh, ...] | None:
    """What `convex_parts` gives, where that takes no time; None where CoACD has not run yet."""
    cached = _cached(mesh)
    return convex_parts(mesh, "") if is_convex(mesh) or cached.is_file() else None


def is_convex(mesh: Mesh) -> bool:
    """Whether the mesh fills its hull."""
    return mesh.volume >= CONVEX * hull(mesh.vertices).volume


def simple(part: Mesh) -> Mesh:
    """A convex part with its support points in 92 directions only, taken in the unit cube; or as it is."""
    directions = geodesic(1.0, FREQUENCY).vertices
    if len(part.vertices) <= len(directions):
        return part
    scaled = part.vertices / part.extents
    return hull(part.vertices[np.unique((scaled @ directions.T).argmax(axis=0))])


def _cached(mesh: Mesh) -> Path:
    """Where the parts of this mesh are kept once they are found."""
    return cache_folder() / "convex" / f"{_key(mesh)}.obj"


def _key(mesh: Mesh) -> str:
    """Names a decomposition: of this mesh, by this version, with these parameters."""
    parameters = f"coacd {version('coacd')} threshold {THRESHOLD} frequency {FREQUENCY}"
    geometry = mesh.vertices.astype("<f8").tobytes() + mesh.faces.astype("<u4").tobytes()
    return hashlib.sha256(parameters.encode() + geometry).hexdigest()


def _decompose(mesh: Mesh, name: str, target: Path, time_limit: float) -> None:
    """Have CoACD write the parts to `target`, whole or not at all."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent) as folder:
            given, found = Path(folder) / "mesh.npz", Path(folder) / "parts.obj"
            np.savez(given, vertices=mesh.vertices, faces=mesh.faces)
            _run_coacd(given, found, name, time_limit)
            found.replace(target)
    except OSError as error:
        raise AssetError(
            f"The convex parts of '{name}' cannot be kept in '{target.parent}': {error.strerror or error}; "
            "name another folder with QDGRASP_CACHE."
        ) from None


def _run_coacd(given: Path, found: Path, name: str, time_limit: float) -> None:
    command = [sys.executable, "-m", __spec__.name, str(given), str(found)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        try:
            process.wait(time_limit)
        except subprocess.TimeoutExpired:
            raise AssetError(
                f"CoACD did not decompose the mesh '{name}' into convex parts within {time_limit:g} s; "
                "simplify the mesh, for example to 20 000 triangles."
            ) from None
        finally:
            process.kill()
        if process.returncode or not found.is_file():
            last = (process.stderr.read() if process.stderr else b"").decode(errors="replace").strip()[-200:]
            raise AssetError(
                f"CoACD could not decompose the mesh '{name}' into convex parts (exit code "
                f"{process.returncode}): {last or 'it says nothing'}."
            )


def main() -> None:
    """Decompose the mesh in the first file into the second; end with whoever started this process."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_starter, daemon=True).start()
    given = np.load(sys.argv[1])
    parts = [simple(hull(points)) for points in _coacd(given["vertices"], given["faces"])]
    Path(sys.argv[2]).write_bytes(parts_to_obj(parts))


def _end_with_starter() -> None:
    """Wait for the end of standard input, whose other end the starter holds."""
    while os.read(0, 1024):
        pass
    os._exit(1)


def _coacd(vertices: Floats, faces: Floats) -> list[Floats]:
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(vertices, faces), threshold=THRESHOLD, seed=0)
    return [np.asarray(points, dtype=np.float64) for points, _ in parts]


if __name__ == "__main__":
    main()
