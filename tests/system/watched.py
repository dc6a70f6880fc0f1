"""A job with real processes, and a monitor that serves its page."""

import re
import subprocess
import threading

from tests.endpoints import own_endpoint
from tests.system.commands import Commands, held, kill, pids, rows_recorded, wait_for

MONITOR = "qdgrasp_coordinator.cli.monitor"


class Watched:
    """A run with two workers on an endpoint of its own, and the address of its page."""

    def __init__(self, qdgrasp: Commands, job: str, *flags: object) -> None:
        self._qdgrasp, self._job, self._endpoint = qdgrasp, job, own_endpoint()
        self.folder = qdgrasp.home / "run"
        place = ("--out", "run", "--job", job, "--listen", self._endpoint)
        self.run = qdgrasp.start("run", *flags, "--workers", 2, *place)
        place = ("--connect", self._endpoint, "--wait", 120)
        self.monitor = qdgrasp.start("--web", "127.0.0.1:0", *place, module=MONITOR)
        self.address = _address(self.monitor)

    def pauses(self, rows: int) -> None:
        """Pause the job when so many rows are on disk; nobody works meanwhile, lest it be over before."""
        wait_for(lambda: rows_recorded(self.folder) >= rows, f"{rows} rows")
        with held(*pids(self.run, "worker")):
            self._order("pause")

    def goes_on(self) -> None:
        """Let a job that was paused go on."""
        self._order("continue")

    def _order(self, command: str) -> None:
        done = self._qdgrasp(command, self._job, "--connect", self._endpoint)
        assert done.code == 0, done.err

    def kill(self, role: str) -> None:
        """End one process of a role, without a word."""
        kill(pids(self.run, role)[0])

    def ends(self) -> None:
        """Wait for the run's end."""
        _, err = self.run.communicate(timeout=1800)
        assert self.run.returncode == 0, err


def _address(monitor: subprocess.Popen[str]) -> str:
    assert monitor.stderr is not None
    for line in monitor.stderr:
        if found := re.search(r"http://127\.0\.0\.1:\d+/", line):
            threading.Thread(target=monitor.stderr.read, daemon=True).start()  # so that it never has to wait
            return found[0]
    raise AssertionError("the monitor says no address")
