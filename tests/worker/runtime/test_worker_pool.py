"""Workers of one command: their arguments, restarts and end."""

import signal

import pytest
from typer.testing import CliRunner

from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.process import (
    DiesAgain,
    ProcessExit,
    ProcessSupervisor,
    RestartPolicy,
    Stop,
    check_workers,
)
from qdgrasp_protocol.session import SECURITY_VARIABLE
from qdgrasp_worker import cli
from qdgrasp_worker.cli import WorkerPool, app


def test_worlds_without_a_device_are_refused():
    refusal = CliRunner().invoke(app, ["--worlds", "64"]).exception
    assert "--worlds goes with a device: name it with --device" in str(refusal)


@pytest.mark.parametrize(("cores", "gigabytes", "most"), [(2, 64, 8), (64, 6, 20), (1, 0.1, 1)])
def test_more_workers_than_cores_or_memory_hold_are_refused(cores, gigabytes, most, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    monkeypatch.setattr("os.sysconf", {"SC_PHYS_PAGES": gigabytes * 1e9 / 4096, "SC_PAGE_SIZE": 4096}.get)
    check_workers(most)
    with pytest.raises(ImpossibleValue, match=f"at most {most}, "):
        check_workers(most + 1)


class Restarts(ProcessSupervisor):
    """Workers that exist by name only: restarts are counted, nothing is started."""

    def __init__(self) -> None:
        self.policy = RestartPolicy()

    def restart_later(self, death: ProcessExit, now: float) -> float:
        pause = self.policy.on_death(now, is_from_outside=False)
        if pause is None:
            raise DiesAgain(death, self.policy.deaths)
        return pause


@pytest.mark.parametrize(
    ("codes", "restarts", "exit_code"),
    [([0], 0, 0), ([2], 0, 2), ([-9, 2, 2], 3, 0), ([1] * 10, 5, 1), ([-11] * 10, 5, 1)],
)
def test_a_worker_is_given_up_that_left_is_hopeless_or_dies_again_and_again(codes, restarts, exit_code):
    processes, pool = Restarts(), WorkerPool(1, [], grace=1.0)
    pool._running = {"worker-0"}
    for code in codes:
        if pool._running:
            pool.on_death(processes, ProcessExit("worker-0", code), 0.0)
    assert min(processes.policy.deaths, 5) == restarts
    assert pool.exit_code == exit_code


def test_workers_get_the_certificates_that_a_variable_names(tmp_path, monkeypatch):
    given: list[list[str]] = []

    class Noted(WorkerPool):
        def run(self, stop: Stop) -> None:
            given.append(self._arguments)

    monkeypatch.setattr(cli, "WorkerPool", Noted)
    CliRunner().invoke(app, ["--workers", "2"], env={SECURITY_VARIABLE: str(tmp_path)})
    assert given
    assert given[0][-2:] == ["--security", str(tmp_path)]


MEMBER = """
import signal, sys
signal.signal(signal.SIGTERM, lambda *_: print("term", flush=True))
signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
print("here", flush=True)
while True:
    signal.pause()
"""


def test_a_second_signal_is_passed_on_to_the_workers(tmp_path, monkeypatch):
    (tmp_path / "obstinate.py").write_text(MEMBER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    stop = Stop()
    killed: list[str] = []

    class Told(ProcessSupervisor):
        def __init__(self, _logs: object, grace: float, _steady: float) -> None:
            super().__init__(tmp_path / "logs", grace)

        def start(self, name, module, arguments):
            super().start(name, "obstinate", list)

        def pids(self):
            said = [log.read_text() for log in (tmp_path / "logs").glob("*.log")]
            if not stop.is_set and said.count("here\n") == 2:
                stop.set(signal.SIGTERM)
            if stop.is_set and said.count("here\nterm\n") == 2:
                stop.set(signal.SIGINT)
            return super().pids()

        def exits(self):
            self.pids()
            return []

        def stop(self, number=signal.SIGTERM):
            killed.extend(self.pids())
            super().stop(number)

    monkeypatch.setattr(cli, "ProcessSupervisor", Told)
    WorkerPool(2, [], grace=600.0).run(stop)
    assert killed == []
