"""A signal ends a wait, also one that the main thread slept through."""

import os
import signal
import subprocess
import sys
import threading
from queue import SimpleQueue

import pytest
from tests.common import PATIENCE

from qdgrasp_protocol.process import SUPERVISED, lifetime


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_wakes_another_thread_is_heard_all_the_same(number: signal.Signals) -> None:
    """A signal between a check for signals and a wait: nothing interrupts the wait."""
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


SPEAKING = r"""
import structlog
from qdgrasp_protocol.process import configure_logging

EVIL = "\x1b[2J\nworker: all is well\u202e"
configure_logging("worker")
log = structlog.get_logger()
log.warning("a sentence of " + EVIL, host=EVIL, list=[EVIL], error=ValueError(EVIL))
try:
    raise ValueError(EVIL)
except ValueError:
    log.exception("it failed")
"""


def test_what_others_wrote_is_escaped_in_sentences_fields_and_tracebacks() -> None:
    done = subprocess.run([sys.executable, "-c", SPEAKING], capture_output=True, check=True)
    lines = done.stderr.decode().split("\n")
    assert all(line.isprintable() for line in lines)
    assert not any(line.startswith("worker: all is well") for line in lines)
    assert sum(line.count(r"\x1b[2J") for line in lines) == 5
    assert any(line.startswith("Traceback") for line in lines)


ORPHAN = """
from qdgrasp_protocol.process import lifetime
from queue import SimpleQueue
inbox = SimpleQueue()
with lifetime("orphan") as stop:
    stop.tell(lambda: inbox.put(None))
    print("ready", flush=True)
    inbox.get()
raise SystemExit(stop.exit_code)
"""


def test_a_supervised_process_ends_when_its_starter_is_gone():
    process = subprocess.Popen(
        [sys.executable, "-c", ORPHAN],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, SUPERVISED: "1"},
    )
    assert process.stdout.readline() == b"ready\n"
    process.stdin.close()
    assert process.wait(PATIENCE) == 128 + signal.SIGTERM
    process.stdout.close()
