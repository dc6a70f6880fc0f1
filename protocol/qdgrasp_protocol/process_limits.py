"""Limits of a process that computes for another one, and its use of processor and memory.

Limits are held by the kernel and by the other process: a call into C cannot put them off.
Usage is read from /proc.
"""

import ctypes
import os
import resource
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

STALL_FACTOR = 10  # Multiple of its limit of CPU seconds for which a simulator may be silent
PROBE_SECONDS = 60.0  # CPU seconds that the probes may take; they take one or two
CPU_LIMIT_SIGNAL, STALL_SIGNAL = signal.SIGPROF, signal.SIGALRM
"""Signals that end a simulator past its limit: of CPU, by the kernel; of silence, by us."""
AUTOGROUP = Path("/proc/self/autogroup")
AUTOGROUP_TRIES, AUTOGROUP_INTERVAL = 100, 0.13  # how often a request is repeated, and its interval [s]
_PR_SET_PDEATHSIG = 1


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """End this process if the block takes more than `seconds` of CPU time."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def limit_memory(size: int) -> bool:
    """Let this process have at most `size` bytes of memory of its own; requests for more fail.

    False if a lower limit was set from outside, which stays.
    """
    with suppress(ValueError, OSError):  # a lower limit stands already
        resource.setrlimit(resource.RLIMIT_DATA, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    return resource.getrlimit(resource.RLIMIT_DATA)[0] == size


def lower_priority(nice: int) -> None:
    """Lower this process's priority by a niceness of 0 (not at all) to 19.

    This process has a session of its own, and where the kernel shares the processor among sessions, niceness
    counts within each only (sched(7), autogroup): so the session's is set too.
    """
    os.nice(nice)
    if nice:
        threading.Thread(target=_lower_session_priority, args=(nice,), name="nice", daemon=True).start()


def _lower_session_priority(nice: int) -> None:
    """Tell the kernel, which takes one such request in a tenth of a second."""
    for _ in range(AUTOGROUP_TRIES):
        try:
            AUTOGROUP.write_text(str(nice))
        except BlockingIOError:
            time.sleep(AUTOGROUP_INTERVAL)
        except OSError:  # this kernel knows no such groups
            return
        else:
            return


def end_with_parent_only() -> None:
    """End with the process that started this one, and by no signal that is meant for a group."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class ProcessStats:
    """Processor time and memory of a process."""

    cpu_seconds: float
    memory: int
    """Memory [bytes]."""
    is_stopped: bool = False
    """True if it is stopped, by SIGSTOP or because it is traced."""


NO_STATS = ProcessStats(0.0, 0)  # For a process that does not exist


def process_stats(pid: int) -> ProcessStats:
    """Return the present processor time and memory of a process."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return NO_STATS
    user, system, pages = (int(fields[place]) for place in (11, 12, 21))
    return ProcessStats((user + system) / TICKS, pages * PAGE, is_stopped=fields[0] in "Tt")
