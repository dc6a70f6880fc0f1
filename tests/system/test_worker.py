"""`qdgrasp-worker` as it is started by hand: several of one command, stopped in any state."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.patience import PATIENCE
from tests.system.commands import LONG, Commands, is_alive, kill, pids, processes_of, rows_recorded, wait_for

ROUTER = """
import sys
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.zenoh_bus import ZenohBus
bus, endpoint = ZenohBus.embedded(sys.argv[1])
with bus, bus.token(Keys("job").coordinator_token(1)):
    print("there", flush=True)
    sys.stdin.read()
"""
"""A router, and a coordinator whose token is there while nobody answers."""


@contextmanager
def router(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-c", ROUTER, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "there\n"
        yield process
        process.kill()


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"unixsock-stream/{tmp_path}/bus"


def start(qdgrasp: Commands, endpoint: str, *options: object) -> subprocess.Popen[str]:
    return qdgrasp.start("--connect", endpoint, *options, module="qdgrasp_worker.cli")


def simulators(worker: int) -> list[int]:
    """The simulators of a worker that are at work: they have taken their name."""
    found = processes_of(worker)
    return [pid for name, pid in found.items() if name.startswith("qdgrasp-simulator")]


def simulator(worker: subprocess.Popen[str]) -> int:
    return wait_for(lambda: simulators(worker.pid), "a simulator")[0]


def stop(worker: subprocess.Popen[str], number: int) -> None:
    """Stop a worker: it ends by itself, without a trace, and so does its simulator."""
    started = list(processes_of(worker.pid).values())
    os.kill(worker.pid, number)
    _, err = worker.communicate(timeout=PATIENCE)
    assert worker.returncode == 128 + number
    assert "Traceback" not in err
    wait_for(lambda: not any(map(is_alive, started)), "the end of its simulator")


STOPS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])


@STOPS
def test_a_worker_stops_while_it_seeks_a_router(qdgrasp, endpoint, number):
    worker = start(qdgrasp, endpoint)
    simulator(worker)
    stop(worker, number)


def test_a_simulator_does_not_outlive_its_worker(qdgrasp, endpoint):
    worker = start(qdgrasp, endpoint)
    left = simulator(worker)
    kill(worker.pid)
    wait_for(lambda: not is_alive(left), "its end")


@STOPS
def test_a_worker_stops_while_a_coordinator_does_not_answer_and_when_its_router_is_gone(
    qdgrasp, endpoint, number
):
    with router(endpoint):
        worker, other = start(qdgrasp, endpoint), start(qdgrasp, endpoint)
        for process in (worker, other):
            simulator(process)
        stop(worker, number)
    stop(other, number)


@STOPS
def test_a_worker_stops_whose_router_stands_still(qdgrasp, endpoint, number):
    with router(endpoint) as still:
        worker = start(qdgrasp, endpoint)
        simulator(worker)
        still.send_signal(signal.SIGSTOP)
        stop(worker, number)


@pytest.fixture
def job(qdgrasp: Commands) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A run without workers of its own, and where they find it."""
    process = qdgrasp.start("run", *LONG, "--batch-size", 10, "--workers", 0, "--out", "run")
    endpoint = qdgrasp.home / "run" / "endpoint"
    wait_for(endpoint.is_file, "the router")
    return process, endpoint.read_text().strip()


@STOPS
def test_a_worker_stops_whose_simulator_stands_still(qdgrasp, job, number):
    process, endpoint = job
    worker = start(qdgrasp, endpoint, "--job", "run")
    wait_for(lambda: rows_recorded(qdgrasp.home / "run") > 0 or worker.poll() is not None, "a row")
    os.kill(simulator(worker), signal.SIGSTOP)
    stop(worker, number)
    assert process.poll() is None


def test_workers_of_one_command_carry_a_job_out_whatever_is_killed(qdgrasp, job, long_digest):
    process, endpoint = job
    team = start(qdgrasp, endpoint, "--job", "run", "--workers", 2, "--pin")
    folder = qdgrasp.home / "run"

    def workers() -> list[int]:
        found = pids(team, "worker")
        return found if len(found) == 2 else []

    def first_simulators() -> list[int]:
        return [pid for worker in workers()[:1] for pid in simulators(worker)]

    for rows, victims in ((20, workers), (50, first_simulators), (90, workers)):
        wait_for(lambda rows=rows: rows_recorded(folder) >= rows, f"{rows} rows")
        kill(wait_for(victims, "somebody to kill")[0])
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert qdgrasp.digest("run") == long_digest
    stop(team, signal.SIGTERM)


def test_simulators_that_end_now_and_then_change_nothing(qdgrasp, job, long_digest):
    process, endpoint = job
    worker = start(qdgrasp, endpoint, "--job", "run")
    folder = qdgrasp.home / "run"
    for rows in (1, 40, 80):
        wait_for(lambda rows=rows: rows_recorded(folder) >= rows, f"{rows} rows")
        os.kill(simulator(worker), signal.SIGSEGV)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert qdgrasp.digest("run") == long_digest
    assert qdgrasp.info("run")["errors"] == 0
    stop(worker, signal.SIGTERM)


def test_workers_that_cannot_be_are_not_started_again_and_again(qdgrasp, endpoint):
    done = qdgrasp.start("--connect", endpoint, "--workers", 2, "--wait", 0, module="qdgrasp_worker.cli")
    _, err = done.communicate(timeout=PATIENCE)
    assert done.returncode == 2
    assert "Nothing answers at" in err
    assert "Traceback" not in err


def test_the_doctor_sees_that_a_simulator_works_here(qdgrasp):
    done = qdgrasp("doctor")
    assert done.code == 0, done.err + done.out
    assert "ok      simulator  probe set" in done.out
