"""A signal ends a wait, also one that the main thread slept through."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from queue import SimpleQueue

import pytest
from setproctitle import getproctitle, setproctitle
from tests.common import PATIENCE

from qdgrasp_protocol.process import BACK_OFF_LAST, SUPERVISED, ProcessExit, ProcessGroup, back_off, lifetime
from qdgrasp_protocol.session import SECURITY_VARIABLE

OPEN = Path("/proc/self/fd")
SLEEP = "import time; time.sleep(600)"


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


def test_a_title_has_no_blanks_at_which_slurm_would_stop_reading() -> None:
    before = getproctitle()
    try:
        with lifetime("qdgrasp campaign"):
            assert getproctitle() == "qdgrasp-campaign"
            assert Path("/proc/self/stat").read_text().partition(") ")[0].count(" ") == 1
    finally:
        setproctitle(before)


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


@pytest.fixture
def processes(tmp_path):
    with ProcessGroup(tmp_path / "logs") as processes:
        yield processes


def start(processes: ProcessGroup, code: str, name: str = "started") -> subprocess.Popen[bytes]:
    """Start a process that executes some code."""
    processes.start(name, "timeit", ["-n1", "-r1", code])
    return processes.process(name)


def test_a_death_is_told_once_with_its_exit_code(processes):
    start(processes, "import os; os._exit(3)", "sleeper").wait(PATIENCE)
    assert processes.exits() == [ProcessExit("sleeper", 3)]
    assert processes.exits() == []


def test_a_killed_member_is_started_again_when_its_back_off_is_over(processes):
    sleeper = start(processes, SLEEP, "sleeper")
    sleeper.kill()
    sleeper.wait(PATIENCE)
    (death,) = processes.exits()
    assert death.description == "was killed by SIGKILL"
    pause = processes.restart_later("sleeper", now=100.0)
    processes.restart_due(100.0 + pause - 0.01)
    assert processes.pids() == {}
    processes.restart_due(100.0 + pause)
    assert set(processes.pids()) == {"sleeper"}


def test_a_member_takes_no_certificates_but_those_that_it_is_told_of(processes, monkeypatch):
    monkeypatch.setenv(SECURITY_VARIABLE, "security")
    asked = start(processes, f"import os; os._exit(5 if {SECURITY_VARIABLE!r} in os.environ else 4)")
    assert asked.wait(PATIENCE) == 4


def test_back_off_grows_to_a_limit():
    pauses = [back_off(n) for n in range(12)]
    assert pauses == sorted(pauses)
    assert pauses[-1] == BACK_OFF_LAST


def test_leaving_ends_everybody_by_force_if_need_be(tmp_path):
    stubborn = "import signal, time; signal.signal(15, signal.SIG_IGN); print(1, flush=True); time.sleep(600)"
    with ProcessGroup(tmp_path) as processes:
        process = start(processes, stubborn)
    assert process.poll() is not None


def test_the_last_words_of_a_member_are_the_sentence_it_ended_with(processes, tmp_path):
    mark = str(tmp_path / "mark")
    said = r"os.write(1, b'qdgrasp-x: a: b\nqdgrasp-x: at: last\n12:00 [x]\n')"
    talk = f"import os; os.path.exists({mark!r}) or {said}; open({mark!r}, 'w'); os._exit(2)"
    start(processes, talk, "talker").wait(PATIENCE)
    assert processes.last_error("talker") == "at: last"
    assert len(processes.exits()) == 1
    processes.restart_due(processes.restart_later("talker", now=0.0))
    assert processes.process("talker").wait(PATIENCE) == 2
    assert processes.last_error("talker") == ""  # of the second process, which says nothing


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


def test_who_is_bidden_to_leave_has_the_grace_from_then_on(tmp_path):
    with ProcessGroup(tmp_path, grace=600) as processes:
        polite = start(processes, SLEEP)
        processes.request_stop()
        polite.wait(PATIENCE)
    assert polite.returncode == -signal.SIGTERM
