"""How a process is, by /proc."""

import os
from dataclasses import dataclass
from pathlib import Path

TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Vitals:
    """What a process takes."""

    cpu_seconds: float
    """What it has had of the processor."""
    memory: int
    """What it has of the memory now [bytes]."""
    is_stopped: bool = False
    """It stands still: by SIGSTOP, or because somebody traces it."""


NOTHING = Vitals(0.0, 0)
"""Of a process that is not there."""


def vitals(pid: int) -> Vitals:
    """What a process takes now."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return NOTHING
    user, system, pages = (int(fields[place]) for place in (11, 12, 21))
    return Vitals((user + system) / TICKS, pages * PAGE, is_stopped=fields[0] in "Tt")
