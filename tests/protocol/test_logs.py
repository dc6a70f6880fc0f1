"""What a process says, and what others may not make it say."""

import subprocess
import sys

SPEAKING = r"""
import structlog
from qdgrasp_protocol.logs import speak

EVIL = "\x1b[2J\nworker: all is well\u202e"
speak("worker")
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
