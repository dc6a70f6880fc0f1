"""Jobs and workers while they go on: seen, paused, drained, stopped."""

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.common import own_endpoint, wait_for
from tests.system.commands import (
    LONG,
    SMALL,
    WORKER,
    Commands,
    end_of,
    has_rows,
    held,
    is_alive,
    kill,
    pids,
    processes_of,
    rows_recorded,
    stop,
)
from tests.system.test_bad_input import sentence

from qdgrasp_protocol.zenoh_bus import ZenohBus


class Running:
    """A run on an endpoint of its own, of which some rows are on disk."""

    def __init__(self, qdgrasp: Commands, *flags: object) -> None:
        self.qdgrasp, self.endpoint, self.folder = qdgrasp, own_endpoint(), qdgrasp.home / "mugs"
        command = ("run", *LONG, "--workers", 2, "--out", "mugs")
        self.process = qdgrasp.start(*command, "--listen", self.endpoint, *flags)
        has_rows(self.process, self.folder, 20)

    def __call__(self, command: str, *arguments: str):
        return self.qdgrasp(command, *arguments, "--connect", self.endpoint)

    def at_rest(self):
        """Stop the workers for a while, so that the job does not end."""
        return held(*wait_for(lambda: two(pids(self.process, "worker")), "both workers"))

    def jobs(self) -> list[dict]:
        """The views of all jobs; none while there is no router."""
        done = self("jobs", "--json")
        return done.json["jobs"] if done.code == 0 else []

    def shown(self) -> dict:
        (job,) = self.jobs()
        return job


def two(found: list[int]) -> list[int]:
    return found if len(found) == 2 else []


def is_idle(job: dict) -> bool:
    """Whether both of its workers are there, and have nothing to do."""
    workers = [(worker["state"], worker["batches"]) for worker in job["workers"]]
    return workers == [("idle", 0)] * 2


def test_a_job_is_seen_paused_continued_and_ends_with_the_same_digest(qdgrasp, long_digest):
    run = Running(qdgrasp)
    with run.at_rest():
        assert "is paused" in run("pause", "mugs").out
    wait_for(lambda: is_idle(run.shown()), "idle workers")
    paused = run.shown()
    assert (paused["figures"]["state"], paused["figures"]["recorders"]) == ("paused", 1)
    assert run.shown()["figures"]["evaluations"] == paused["figures"]["evaluations"]
    assert "paused until `qdgrasp continue mugs`" in run("jobs").out
    assert "Unknown job 'bowls'. Known: mugs." in sentence(run("cancel", "bowls"))
    kill(pids(run.process, "coordinator")[0])
    wait_for(lambda: [job["meta"]["epoch"] for job in run.jobs()] == [2], "the next coordinator's turn")
    assert run.shown()["figures"]["state"] == "paused"
    assert run("continue", "mugs").out == "Job 'mugs' goes on.\n"
    end_of(run.process)
    assert qdgrasp.digest("mugs") == long_digest


@pytest.mark.slow
def test_a_cancelled_job_keeps_what_it_has_and_can_be_gone_on_with(qdgrasp, long_digest):
    run = Running(qdgrasp)
    with run.at_rest():
        assert "Job 'mugs' ends" in run("cancel", "mugs").out
    _, err = end_of(run.process, 1)
    assert "Job 'mugs' was cancelled. `qdgrasp resume mugs` continues" in err
    assert rows_recorded(run.folder) >= 20
    qdgrasp.succeed("resume", "mugs", "--workers", 1)
    assert qdgrasp.digest("mugs") == long_digest


@pytest.mark.slow
def test_a_run_ends_with_its_goal_and_is_extended_from_there(qdgrasp):
    goal = ("run", *SMALL, "--evaluations", 200, "--workers", 1)
    done = qdgrasp.succeed(*goal, "--grasps", 3, "--out", "run")
    assert "It ended early: 3 grasps are found." in done.out
    assert "is finished" in qdgrasp("resume", "run").out
    assert "grasps must be reached by the last row" in sentence(qdgrasp("resume", "run", "--grasps", 2))
    qdgrasp.succeed("resume", "run", "--grasps", 6, "--workers", 1)
    qdgrasp.succeed(*goal, "--grasps", 6, "--out", "whole")
    assert qdgrasp.digest("run") == qdgrasp.digest("whole")


def test_where_nobody_is_it_is_said(qdgrasp):
    endpoint = own_endpoint()
    with ZenohBus.router(endpoint):
        assert qdgrasp("jobs", "--connect", endpoint).out.startswith(f"No job is at {endpoint}")
        assert qdgrasp("jobs", "--connect", endpoint, "--json").json == {"endpoint": endpoint, "jobs": []}
        assert "No job is at" in sentence(qdgrasp("pause", "mugs", "--connect", endpoint))
    assert "worker" in sentence(qdgrasp("drain", "mugs", "--worker", "Moon", "--connect", endpoint))


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"unixsock-stream/{tmp_path}/bus"


def start(qdgrasp: Commands, endpoint: str, *options: object) -> subprocess.Popen[str]:
    return qdgrasp.start("--connect", endpoint, *options, module=WORKER)


def simulators(worker: int) -> list[int]:
    """The simulators of a worker that are at work: they have taken their name."""
    return [pid for name, pid in processes_of(worker).items() if name.startswith("qdgrasp-simulator")]


def simulator(worker: subprocess.Popen[str]) -> int:
    return wait_for(lambda: simulators(worker.pid), "a simulator")[0]


def test_a_simulator_does_not_outlive_its_worker(qdgrasp, endpoint):
    worker = start(qdgrasp, endpoint)
    left = simulator(worker)
    kill(worker.pid)
    wait_for(lambda: not is_alive(left), "its end")


@pytest.fixture
def job(qdgrasp: Commands) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A run without workers of its own, and where they find it."""
    process = qdgrasp.start("run", *LONG, "--workers", 0, "--out", "run")
    endpoint = qdgrasp.home / "run" / "endpoint"
    wait_for(endpoint.is_file, "the router")
    return process, endpoint.read_text().strip()


@pytest.mark.slow
def test_workers_of_one_command_carry_a_job_out_whatever_is_killed(qdgrasp, job, long_digest):
    process, endpoint = job
    team = start(qdgrasp, endpoint, "--job", "run", "--workers", 2)
    folder = qdgrasp.home / "run"

    def workers() -> list[int]:
        found = pids(team, "worker")
        return found if len(found) == 2 else []

    def first_simulators() -> list[int]:
        return [pid for worker in workers()[:1] for pid in simulators(worker)]

    for rows, victims in ((20, workers), (50, first_simulators), (90, workers)):
        wait_for(lambda rows=rows: rows_recorded(folder) >= rows, f"{rows} rows")
        kill(wait_for(victims, "somebody to kill")[0])
    end_of(process)
    assert qdgrasp.digest("run") == long_digest
    stop(team, signal.SIGTERM)


def test_the_doctor_sees_that_a_simulator_works_here(qdgrasp):
    done = qdgrasp.succeed("doctor")
    assert "ok      simulator  probes " in done.out
    assert "mujoco probes " in done.out
    assert "pybullet " in done.out
