"""The plan of disturbances, the processes, and the undisturbed run."""

import os
import signal
import subprocess
import sys
from itertools import islice
from pathlib import Path

import pytest
from tests.chaos.plan import HEAD, FaultKind, RunKind, faults, first_round
from tests.chaos.play import disturb, undisturbed_digest
from tests.chaos.processes import ROOT
from tests.common import wait_for
from tests.system.commands import is_alive, kill

SERVER = ("http.server", ["0", "--bind", "127.0.0.1"])
"""Lives until it is ended."""
STARTER = f"""
import sys
from pathlib import Path
from tests.chaos.processes import Process
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


SEED = 4
EVALUATIONS = 300
CHAOS_WORKERS = 4
SHORT_INTERVALS = (0.8, 1.6)
ROW_SECONDS = CHAOS_WORKERS * first_round(CHAOS_WORKERS) * SHORT_INTERVALS[1] / EVALUATIONS
"""So slow that the run is not over before the first round of faults is."""
RUN_KIND = RunKind("contact_rand", "paper", 60, ROW_SECONDS)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_disturbed_run_gives_what_an_undisturbed_one_gives(tmp_path: Path, undisturbed: Path) -> None:
    spec = RUN_KIND.spec(SEED, EVALUATIONS)
    expected = undisturbed_digest(spec, undisturbed)
    plan = islice(faults(SEED, CHAOS_WORKERS, SHORT_INTERVALS), first_round(CHAOS_WORKERS))
    report = disturb(
        tmp_path / "run", spec, plan, workers=CHAOS_WORKERS, row_seconds=ROW_SECONDS, limit=300, say=print
    )
    assert report.troubles == []
    assert {(kind, FaultKind.KILL) for kind in ("worker", *HEAD)} <= set(report.injected)
    assert any(kind is FaultKind.STOP for _, kind in report.injected)
    assert report.digest == expected
