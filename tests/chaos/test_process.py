"""Nobody is left behind."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.chaos.process import ROOT, Process
from tests.patience import PATIENCE
from tests.system.commands import is_alive, kill, wait_for

SERVER = ("http.server", ["0", "--bind", "127.0.0.1"])
"""Lives until it is ended."""
STARTER = f"""
import sys
from pathlib import Path
from tests.chaos.process import Process
process = Process("server", *{SERVER!r}, Path(sys.argv[1]))
process.start()
print(process.pid, flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_process_ends_with_its_starter_however_that_ends(tmp_path: Path, is_stopped: bool) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", STARTER, tmp_path / "log"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as starter:
        assert starter.stdout is not None
        pid = int(starter.stdout.readline())
        if is_stopped:
            os.kill(pid, signal.SIGSTOP)
        assert is_alive(pid)
        kill(starter.pid)
    wait_for(lambda: not is_alive(pid), "the end of the orphan")


def test_a_process_is_started_again_under_the_same_name_and_heard_in_one_log(tmp_path: Path) -> None:
    process = Process("server", "platform", [], tmp_path / "log")
    for _ in range(2):
        process.start()
        assert process.wait(PATIENCE) == 0
    first, second = process.words.splitlines()
    assert first == second == process.last_words


def test_a_killed_process_is_gone_and_a_stopped_one_is_known_to_be(tmp_path: Path) -> None:
    process = Process("server", *SERVER, tmp_path / "log")
    process.start()
    process.send(signal.SIGSTOP)
    assert (process.is_there, process.is_stopped) == (True, True)
    process.send(signal.SIGKILL)
    assert (process.is_there, process.exit_code) == (False, -signal.SIGKILL)
