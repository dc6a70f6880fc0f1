"""Packages that the main job does without, and the extras that bring them."""

from importlib.util import find_spec
from typing import Self

from qdgrasp_protocol.errors import InputError

EXTRAS = {
    "export": ("h5py", "pyarrow"),
    "gpu": ("mujoco_warp", "warp"),
    "monitor": ("prometheus_client", "sse_starlette", "starlette", "uvicorn"),
}
"""The packages of each extra of pyproject.toml, as they are imported."""


class MissingPackage(InputError):
    """A package of an extra is needed, and not installed here; `need` is what needs it."""

    def __init__(self, need: str, package: str, extra: str) -> None:
        super().__init__(
            f"{need} needs {package}, which is not installed here; install it with "
            f"`pip install 'qdgrasp[{extra}]'`."
        )
        self._words = need, package, extra

    def __reduce__(self) -> tuple[type[Self], tuple[str, str, str]]:
        """Come out of another process as it is."""
        return type(self), self._words


def check_packages(need: str, *packages: str) -> None:
    """Raise `MissingPackage` for the first of these packages that is not installed here.

    `need` begins the sentence: the format, method or option that cannot do without them.
    """
    for package in packages:
        if find_spec(package) is None:
            raise MissingPackage(need, package, next(name for name in EXTRAS if package in EXTRAS[name]))
