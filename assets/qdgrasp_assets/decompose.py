"""Decomposition: CoACD in a process of its own, which can be given up, and parts with few corners.

Run as a module (`python -m qdgrasp_assets.decompose IN.npz THRESHOLD OUT.obj`) this is that process.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
from itertools import product
from pathlib import Path

import numpy as np

from qdgrasp_assets.mesh import Floats, Mesh, parts_to_obj, read_parts
from qdgrasp_assets.objects.solids import heights, hull
from qdgrasp_protocol.errors import AssetError

TOLERANCE = 5e-4
"""A corner that is not farther outside the hull of others is left out [m]."""
CORNERS = 128
"""Of a part, at most."""
ITERATIONS = 50
"""Of CoACD's search for each cut. With its own 150 it takes half as long again, for parts no fewer."""
BLOCK = 1 << 17
"""So many corners are compared at once: their distances from `CORNERS` and their faces fill 300 MB."""
OUTWARD = np.array([*np.eye(3), *-np.eye(3), *product((-1.0, 1.0), repeat=3)])
"""The directions in which a part keeps its extent, in the unit cube."""


class TookTooLong(AssetError):
    """CoACD did not come to an end in time."""

    def __init__(self, name: str, seconds: float) -> None:
        super().__init__(
            f"CoACD did not decompose the mesh '{name}' into convex parts within {seconds:g} s; simplify the "
            "mesh, for example to 20 000 triangles."
        )


def decompose(mesh: Mesh, name: str, threshold: float, time_limit: float) -> tuple[Mesh, ...]:
    """Convex parts that together fill a mesh, in its frame, with few corners each.

    Parameters
    ----------
    mesh
        A closed surface [m]; one or several bodies.
    name
        How errors call it.
    threshold
        CoACD's concavity: the smaller, the more parts.
    time_limit
        How long it may take [s].

    Raises
    ------
    TookTooLong
        It took longer.
    AssetError
        CoACD failed.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as folder:
        given, found = Path(folder) / "mesh.npz", Path(folder) / "parts.obj"
        np.savez(given, vertices=mesh.vertices, faces=mesh.faces)
        _run([str(given), str(threshold), str(found)], name, time_limit)
        if not found.is_file():
            raise AssetError(f"CoACD found no convex parts of the mesh '{name}'.")
        return read_parts(found)


def _run(arguments: list[str], name: str, time_limit: float) -> None:
    command = [sys.executable, "-m", __spec__.name, *arguments]
    with (
        tempfile.TemporaryFile() as said,  # not a pipe, which would fill while nobody reads it
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said) as process,
    ):
        try:
            process.wait(max(0.0, time_limit))
        except subprocess.TimeoutExpired:
            raise TookTooLong(name, time_limit) from None
        finally:
            process.kill()
        if process.returncode:
            said.seek(0)
            last = " ".join(said.read().decode(errors="replace").split())[-200:]
            raise AssetError(
                f"CoACD could not decompose the mesh '{name}' into convex parts (exit code "
                f"{process.returncode}): {last or 'it says nothing'}."
            )


def simple(part: Mesh) -> Mesh:
    """A convex part with no more of its corners than it takes to leave none farther outside than `TOLERANCE`.

    It begins with those that are farthest in a few directions, and adds the one that is farthest outside
    until none is, or until it has `CORNERS`.
    """
    corners = part.vertices
    blocks = [corners[start : start + BLOCK] for start in range(0, len(corners), BLOCK)]
    kept = _outermost(corners)
    while True:
        found = hull(corners[kept])
        outside = np.concatenate([heights(found, block).max(axis=1) for block in blocks])
        if outside.max() <= TOLERANCE or len(kept) >= CORNERS:
            return found
        kept.append(int(outside.argmax()))


def _outermost(corners: Floats) -> list[int]:
    """Some of the corners (v, 3) of a solid, by their place; they are not in one plane."""
    places = (corners / np.ptp(corners, axis=0) @ OUTWARD.T).argmax(axis=0)
    some = corners[places]
    across = corners @ np.linalg.svd(some - some.mean(axis=0))[2][-1]
    return sorted({*places.tolist(), int(across.argmin()), int(across.argmax())})


def main() -> None:
    """Decompose the mesh in the first file into the last; end with whoever started this process."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_starter, daemon=True).start()
    given = np.load(sys.argv[1], allow_pickle=False)
    parts = [simple(hull(points)) for points in _coacd(given["vertices"], given["faces"], float(sys.argv[2]))]
    Path(sys.argv[3]).write_bytes(parts_to_obj(parts))


def _end_with_starter() -> None:
    """Wait for the end of standard input, whose other end the starter holds."""
    while os.read(0, 1024):
        pass
    os._exit(1)


def _coacd(vertices: Floats, faces: Floats, threshold: float) -> list[Floats]:
    import coacd

    coacd.set_log_level("error")
    mesh = coacd.Mesh(vertices, faces)
    parts = coacd.run_coacd(mesh, threshold=threshold, mcts_iterations=ITERATIONS, seed=0)
    return [np.asarray(points, dtype=np.float64) for points, _ in parts]


if __name__ == "__main__":
    main()
