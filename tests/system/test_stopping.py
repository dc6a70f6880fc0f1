"""Every command stops when it is asked to, in any state."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from http.client import HTTPConnection
from pathlib import Path

import pytest
import trimesh
from tests.common import PATIENCE, own_endpoint, wait_for
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from tests.system.commands import (
    SMALL,
    WORKER,
    Commands,
    has_rows,
    pids,
    processes_of,
    rows_recorded,
    says,
    stop,
)

PROMISED = 2.0
"""Seconds that a command may take to stop, on a machine that is not busy with something else."""
COMPUTING = 0.5
"""Of these it computes at most so long, which takes longer where others compute too; the rest it waits."""
SPIN = 0.1
"""CPU seconds by which it is found out how busy this machine is."""
LONG = (*SMALL, "--evaluations", 100_000)
Beginning = Callable[[Commands], subprocess.Popen[str]]


def working(qdgrasp: Commands) -> subprocess.Popen[str]:
    process = qdgrasp.start("run", *LONG, "--workers", 2, "--out", "run")
    has_rows(process, qdgrasp.home / "run", 1)
    return process


def frozen(role: str) -> Beginning:
    """A run of which one process hears nothing any more; where it is the coordinator, the router is away."""

    def begin(qdgrasp: Commands) -> subprocess.Popen[str]:
        process = working(qdgrasp)
        for pid in pids(process, role):
            os.kill(pid, signal.SIGSTOP)
        return process

    return begin


def ring(home: Path) -> None:
    """Write a mesh whose scene takes long to build."""
    trimesh.creation.torus(0.03, 0.012, 60, 40).export(home / "ring.stl")


def campaigning(qdgrasp: Commands) -> subprocess.Popen[str]:
    ring(qdgrasp.home)
    file = qdgrasp.home / "many.toml"
    file.write_text('[[cross]]\ngripper = "panda"\nobject = "ring.stl"\nmass = 1.0\nseed = [0, 1]\n')
    process = qdgrasp.start("campaign", file, "--out", "many")
    says(process, "listening on")
    return process


def seeking(*command: str, module: str = "qdgrasp") -> Beginning:
    """A command whose router is not there."""

    def begin(qdgrasp: Commands) -> subprocess.Popen[str]:
        process = qdgrasp.start(*command, "--connect", own_endpoint(), module=module)
        wait_for(lambda: _is_loaded(process.pid), "its threads")
        return process

    return begin


def with_a_hanging_simulator(qdgrasp: Commands) -> subprocess.Popen[str]:
    """A worker of a job elsewhere, whose simulator stands still with a batch."""
    endpoint = own_endpoint()
    qdgrasp.start("run", *LONG, "--workers", 0, "--out", "run", "--listen", endpoint)
    process = qdgrasp.start("--connect", endpoint, module=WORKER)
    wait_for(lambda: rows_recorded(qdgrasp.home / "run") > 0, "rows")
    for pid in processes_of(process.pid).values():
        os.kill(pid, signal.SIGSTOP)
    return process


def viewing(qdgrasp: Commands) -> subprocess.Popen[str]:
    """A page of a finished run, open in a browser."""
    record(qdgrasp.home / "mug", made_scene(), random_rows(20))
    process = qdgrasp.start("view", "mug")
    assert process.stdout is not None
    address = re.search(r"http://127\.0\.0\.1:(\d+)/", process.stdout.readline())
    assert address
    connection = HTTPConnection("127.0.0.1", int(address[1]), timeout=PATIENCE)
    process.page = connection  # type: ignore[attr-defined]  # it stays open, as a browser's does
    connection.request("GET", "/api/jobs/mug/runs/run/scene")
    answer = connection.getresponse()
    assert (answer.status, answer.read()[:1]) == (200, b"{")
    return process


def looking(*command: object) -> Beginning:
    """A command that evaluates recorded rows again."""

    def begin(qdgrasp: Commands) -> subprocess.Popen[str]:
        qdgrasp.succeed("run", *SMALL, "--evaluations", 60, "--workers", 2, "--out", "run")
        process = qdgrasp.start(*command)
        wait_for(lambda: bool(processes_of(process.pid)), "its processes")
        return process

    return begin


def _is_loaded(pid: int) -> bool:
    return len(list(Path(f"/proc/{pid}/task").iterdir())) > 4


BEGINNINGS: dict[str, Beginning] = {
    "a run": working,
    "a run whose router is away": frozen("coordinator"),
    "a run whose workers hang": frozen("worker"),
    "a campaign's scene that is built": campaigning,
    "jobs without a router": seeking("jobs"),
    "a worker without a router": seeking(module=WORKER),
    "a worker whose simulator hangs": with_a_hanging_simulator,
    "an evaluation that is filmed": looking("render", "run", "--grasp", 0, "-o", "a.gif"),
    "rows that are verified": looking("verify", "run", "--all"),
    "a page of a finished run": viewing,
}
QUICK = {"a page of a finished run": signal.SIGINT, "jobs without a router": signal.SIGTERM}


@pytest.mark.parametrize(("name", "number"), QUICK.items(), ids=QUICK)
def test_a_command_stops_with_all_its_processes(qdgrasp: Commands, name: str, number: int) -> None:
    stop(BEGINNINGS[name](qdgrasp), number)


def scarcity() -> float:
    """How many times as long as on an idle machine something takes here now, because others compute too."""
    began, end = time.monotonic(), time.process_time() + SPIN
    while time.process_time() < end:
        pass
    return max(1.0, (time.monotonic() - began) / SPIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", BEGINNINGS)
def test_a_command_stops_within_two_seconds(qdgrasp: Commands, name: str) -> None:
    before = scarcity()
    _, _, took = stop(BEGINNINGS[name](qdgrasp), signal.SIGINT)
    assert took < PROMISED + COMPUTING * (max(before, scarcity()) - 1)
