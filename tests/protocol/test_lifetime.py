"""A signal ends a wait, also one that the main thread slept through."""

import signal
import threading
from pathlib import Path
from queue import SimpleQueue

import pytest
from tests.patience import PATIENCE

from qdgrasp_protocol.lifetime import lifetime

OPEN = Path("/proc/self/fd")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_wakes_another_thread_is_heard_all_the_same(number: signal.Signals) -> None:
    """As one does that comes between a look for signals and a wait: nothing interrupts the wait."""
    inbox, rest = SimpleQueue[str](), threading.Event()
    before = signal.getsignal(number)
    with lifetime("test") as stop:
        stop.tell(lambda: inbox.put("asked to stop"))
        other = threading.Thread(target=rest.wait, args=(PATIENCE,))
        other.start()
        late = threading.Timer(0.2, signal.pthread_kill, (other.ident, number))
        late.start()
        assert inbox.get(timeout=PATIENCE) == "asked to stop"
        rest.set()
        other.join()
        late.join()
        assert stop.exit_code == 128 + number
    assert signal.getsignal(number) is before


def test_a_lifetime_leaves_nothing_open() -> None:
    with lifetime("test"):
        pass
    known = len(list(OPEN.iterdir()))
    for _ in range(20):
        with lifetime("test"):
            pass
    for thread in threading.enumerate():
        if thread.name == "signals":
            thread.join(PATIENCE)
    assert len(list(OPEN.iterdir())) <= known
