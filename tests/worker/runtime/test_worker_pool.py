"""Workers of one command: their arguments, restarts and end."""

import signal
from unittest.mock import Mock, call

import typer.main
from typer.testing import CliRunner

from qdgrasp_protocol.process import ProcessExit, ProcessGroup, Stop
from qdgrasp_worker.cli import app
from qdgrasp_worker.runtime import worker_pool as teams
from qdgrasp_worker.runtime.worker_pool import POOL_OPTIONS, StartupCheck, WorkerPool, worker_arguments


def parsed(given: list[str]) -> typer.Context:
    return typer.main.get_command(app).make_context("qdgrasp-worker", list(given))


def test_workers_of_a_team_are_started_with_the_options_of_the_team_but_for_its_own():
    team = parsed(
        ["--connect", "tls/a:1,tls/b:2", "--security", "here", "--workers", "4", "--pin", "--grace", "9.5"]
    )
    member = parsed(worker_arguments(team))
    changed = {name for name, value in team.params.items() if member.params[name] != value}
    assert changed == set(POOL_OPTIONS)
    assert (member.params["workers"], member.params["pin"]) == (1, False)


def test_worlds_without_a_device_are_refused():
    refusal = CliRunner().invoke(app, ["--worlds", "64"]).exception
    assert "--worlds goes with a device: name it with --device" in str(refusal)


def hopeless(*deaths: tuple[str, int, float]) -> list[bool]:
    """Return for each death, at its time, whether it ends a pool of two that starts within 90 s."""
    beginning = StartupCheck(2, until=90.0)
    return [beginning.is_hopeless(ProcessExit(name, code), now) for name, code, now in deaths]


def test_a_team_ends_when_bad_input_ended_the_first_process_of_each_worker():
    assert hopeless(("a", 2, 1.0), ("a", 2, 2.0), ("b", 2, 3.0)) == [False, False, True]


def test_one_worker_that_finds_no_router_does_not_end_those_that_serve():
    assert not any(hopeless(*(("a", 2, float(time)) for time in range(1000))))


def test_workers_that_served_are_started_again_however_often_they_find_no_router():
    killed = [(name, -signal.SIGKILL, 5.0) for name in "ab"]
    assert not any(hopeless(*killed, *((name, 2, 50.0) for name in "ab")))


def test_a_worker_that_leaves_long_after_its_beginning_does_not_end_one_that_began_late():
    assert not any(hopeless(("a", 2, 1.0), ("b", 2, 5000.0)))


def test_a_worker_that_is_turned_away_while_another_serves_is_started_again():
    processes, pool = Mock(), WorkerPool(2, [], grace=1.0, wait=0.0, is_pinned=False)
    processes.restart_later.return_value = 0.5
    for _ in range(2):
        pool._on_exit(processes, ProcessExit("worker-0", 2), 0.0)
    assert processes.restart_later.call_args_list == [call("worker-0", 0.0)] * 2


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

    class Told(ProcessGroup):
        def __init__(self, _logs: object, grace: float) -> None:
            super().__init__(tmp_path / "logs", grace)

        def start(self, name, module, arguments, core=None):
            super().start(name, "obstinate", [], core)

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

    monkeypatch.setattr(teams, "ProcessGroup", Told)
    WorkerPool(2, [], grace=600.0, wait=0.0, is_pinned=False).run(stop)
    assert killed == []
