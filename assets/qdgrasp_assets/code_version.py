"""Versions of the code that checks meshes and builds shapes.

A version is made of digests of modules and versions of packages. Nothing is imported for it, so that a
process without arrays can state the version of its machine.
"""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

CHECKING_MODULES = (
    *("geometry.mesh", "geometry.mesh_io", "geometry.mesh_repair", "geometry.primitives"),
    *("geometry.proximity", "geometry.remesh", "geometry.surface_points", "object_model", "mesh_check"),
)
CHECKING_PACKAGES = ("embreex", "fast-simplification", "numpy", "scipy", "trimesh")
BUILDING_MODULES = (*CHECKING_MODULES, "geometry.collision_parts", "object_shape")
BUILDING_PACKAGES = (*CHECKING_PACKAGES, "coacd")


def checking_code() -> str:
    """Return the digest of the code that checks meshes, and of the versions of its packages."""
    return _code_digest(CHECKING_MODULES, CHECKING_PACKAGES)


def building_code() -> str:
    """Return the digest of the code that builds shapes, and of the versions of its packages."""
    return _code_digest(BUILDING_MODULES, BUILDING_PACKAGES)


@cache
def _code_digest(modules: tuple[str, ...], packages: tuple[str, ...]) -> str:
    specs = [find_spec(f"{__package__}.{name}") for name in modules]
    files = [file_digest(Path(spec.origin)) for spec in specs if spec and spec.origin]
    return hashlib.sha256(" ".join((*files, *map(_package_version, packages))).encode()).hexdigest()


def _package_version(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"{name} absent"


def file_digest(path: Path) -> str:
    """Return the sha256 of a file's bytes; of no bytes where there is no such file."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return hashlib.sha256().hexdigest()
