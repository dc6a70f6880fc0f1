"""Modules that a worker's process loads before its first result, each at a cost of time."""

import json
import subprocess
import sys

import pytest

from qdgrasp_protocol.spec import has_bullet

LISTED = "import json, sys; {}; print(json.dumps(sorted(sys.modules)))"
SERVE = "import qdgrasp_worker.cli, qdgrasp_worker.runtime.service, qdgrasp_protocol.zenoh_bus"
EVALUATE = (
    "import qdgrasp_worker.runtime.simulator_main; from qdgrasp_worker.platform import platform; platform()"
)
"""All that comes before a worker asks to join: its simulator's imports, and the probes."""
SIMULATION = {"mujoco", "numpy", "scipy"} | ({"pybullet"} if has_bullet() else set())
HEAVY = {"embreex", "matplotlib", "numba", "PIL", "ribs", "sklearn", "trimesh"}
"""Modules of others: meshes, pictures, searches; each takes a tenth of a second or more."""


def loaded(statements: str) -> set[str]:
    """The modules of a fresh interpreter after these statements."""
    command = [sys.executable, "-c", LISTED.format(statements)]
    said = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    return set(json.loads(said.splitlines()[-1]))


@pytest.fixture(scope="module")
def worker() -> set[str]:
    return loaded(SERVE)


@pytest.fixture(scope="module")
def simulator() -> set[str]:
    return loaded(EVALUATE)


def test_a_worker_has_the_bus_and_no_simulator(worker):
    assert "zenoh" in worker
    assert worker & SIMULATION <= {"numpy"}


def test_a_simulator_has_the_engines_and_no_bus(simulator):
    assert simulator >= SIMULATION
    assert not simulator & {"zenoh", "typer", "structlog"}


def test_neither_has_loaded_what_only_others_need(worker, simulator):
    assert not (worker | simulator) & HEAVY
    assert not [name for name in worker | simulator if name.startswith("qdgrasp_coordinator")]


def test_a_worker_can_be_asked_for_help_without_simulator_and_bus():
    assert not loaded("import qdgrasp_worker.cli") & {"scipy", "pybullet", "zenoh"}
