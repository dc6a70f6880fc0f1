"""Version of the code that checks meshes and builds shapes.

It is made of digests of modules and versions of packages. Nothing is imported for it, so that a
process without arrays can state the version of its machine.
"""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

MODULES = (
    *("geometry.mesh", "geometry.mesh_io", "geometry.mesh_repair", "geometry.proximity"),
    *("geometry.surface_points", "geometry.collision_parts", "geometry.convex_decomposition"),
    *("geometry.rotation", "object_model", "object_shape", "scene"),
)
PACKAGES = ("embreex", "fast-simplification", "numpy", "scipy", "trimesh")


@cache
def building_code() -> str:
    """Return the digest of the code that builds shapes; "" where a package of it is missing."""
    folder = Path(__file__).parent
    files = [file_digest(folder / f"{name.replace('.', '/')}.py") for name in MODULES]
    try:
        packages = [f"{name} {version(name)}" for name in PACKAGES]
    except PackageNotFoundError:
        return ""
    return hashlib.sha256(" ".join((*files, *packages)).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """Return the sha256 of a file's bytes; of no bytes where there is no such file."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return hashlib.sha256().hexdigest()
