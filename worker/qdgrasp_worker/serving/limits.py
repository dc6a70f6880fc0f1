"""What a simulator may take, held by the kernel and its worker: a call into C cannot put these limits off."""

import ctypes
import os
import resource
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

STALL = 10
"""So many times its limit of CPU seconds a simulator may say nothing, on a machine that others use."""
PROBE_SECONDS = 60.0  # CPU seconds that the probes may take; they take one or two
TIME_OVER, CLOCK_OVER = signal.SIGPROF, signal.SIGALRM
"""What ends one that passed its limit: on the CPU, by the kernel, or on the clock, by its worker."""
AUTOGROUP = Path("/proc/self/autogroup")
WISHES, WISH_INTERVAL = 100, 0.13  # how often a wish is repeated, and after how many seconds
_PR_SET_PDEATHSIG = 1


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """End this process if what follows takes more than so many CPU seconds."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def limit_memory(size: int) -> None:
    """Let this process have at most `size` bytes of memory of its own; what asks for more fails."""
    with suppress(ValueError, OSError):  # a lower limit stands already
        resource.setrlimit(resource.RLIMIT_DATA, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def stand_back(nice: int) -> None:
    """Leave the processor to others that want it, 0 (not at all) to 19.

    This process has a session of its own, and where the kernel shares the processor among sessions, niceness
    counts within each only (sched(7), autogroup): so the session stands back too.
    """
    os.nice(nice)
    if nice:
        threading.Thread(target=_stand_back_as_a_session, args=(nice,), name="nice", daemon=True).start()


def _stand_back_as_a_session(nice: int) -> None:
    """Tell the kernel, which hears one such wish in a tenth of a second."""
    for _ in range(WISHES):
        try:
            AUTOGROUP.write_text(str(nice))
        except BlockingIOError:
            time.sleep(WISH_INTERVAL)
        except OSError:  # this kernel knows no such groups
            return
        else:
            return


def heed_the_starter_alone() -> None:
    """End with the process that started this one, and by nothing that is meant for a whole group."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
