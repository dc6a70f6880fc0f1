"""The node: what stands beside figures that were measured on it."""

import importlib.metadata
import os
import platform
from pathlib import Path

from msgspec import Struct

PACKAGES = ("qdgrasp", "pybullet", "numpy", "scipy", "ribs", "eclipse-zenoh")


class Node(Struct, frozen=True, kw_only=True):
    """A machine, and what runs on it."""

    processor: str
    cores: int
    """That this process may use."""
    load: float
    """Processes that wanted to run in the last minute: above 0, others had a share of the cores."""
    memory_bytes: int
    system: str
    python: str
    packages: dict[str, str]
    """Versions."""

    @property
    def words(self) -> str:
        """One line for a person."""
        cores = f"{self.cores} core{'' if self.cores == 1 else 's'}"
        return f"{cores} of {self.processor}, {self.memory_bytes / 2**30:.0f} GiB, load {self.load:.1f}"


def node() -> Node:
    """The node that this process is on."""
    return Node(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)),
        load=os.getloadavg()[0],
        memory_bytes=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        system=platform.platform(),
        python=platform.python_version(),
        packages={name: importlib.metadata.version(name) for name in PACKAGES},
    )


def peak_memory(pid: int) -> int:
    """The most memory that a process and those it started have had [bytes]; 0 where that is not known."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        started = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return 0
    own = next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)
    return own + sum(peak_memory(int(child)) for child in started)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())
