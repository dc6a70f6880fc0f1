"""Devices that evaluate many rows together."""

from typing import NamedTuple, Self

from qdgrasp_protocol.errors import EXTRAS, check_packages

DEVICE_MODULE = "qdgrasp_worker.engines.warp_worlds"
MOST_WORLDS = 4096  # Most genomes of a generation
CPU_WORLDS = 64  # On warp's CPU device, which is for tests


class Device(NamedTuple):
    """A device that evaluates many rows together."""

    name: str
    """Its name in warp: cpu, cuda, cuda:1."""
    worlds: int
    """Rows that it evaluates at once."""

    @classmethod
    def find(cls, name: str, worlds: int | None = None) -> Self:
        """A device by its name; None: as many worlds as fill it. An InputError without the packages."""
        check_packages(f"--device {name}", *EXTRAS["gpu"])
        return cls(name, worlds or (CPU_WORLDS if name == "cpu" else MOST_WORLDS))
