"""Counting what is done against the CPU time that it takes."""

import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("qdgrasp", "pybullet", "numpy", "ribs", "eclipse-zenoh")


@dataclass(frozen=True)
class Figure:
    """So many things took so many seconds."""

    name: str
    count: int
    seconds: float
    clock: str = "cpu"
    remark: str = ""

    @property
    def per_second(self) -> float:
        return self.count / self.seconds

    @property
    def microseconds(self) -> float:
        return 1e6 * self.seconds / self.count

    def as_dict(self) -> dict[str, object]:
        return {
            "name": self.name,
            "count": self.count,
            "seconds": self.seconds,
            "clock": self.clock,
            "per_second": self.per_second,
            "remark": self.remark,
        }


class Meter:
    """CPU seconds of this process within its `running` blocks."""

    seconds: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        began = time.process_time()
        yield
        self.seconds += time.process_time() - began


def machine() -> dict[str, object]:
    models = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line]
    return {
        "cpu": models[0].partition(":")[2].strip() if models else platform.processor(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }
