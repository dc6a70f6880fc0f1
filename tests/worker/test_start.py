"""What a worker's process loads before its first result: what it does not need would come on top of it."""

import json
import subprocess
import sys

import pytest

LISTED = "import json, sys; {}; print(json.dumps(sorted(sys.modules)))"
SERVE = "import qdgrasp_worker.cli, qdgrasp_worker.service, qdgrasp_protocol.zenoh_bus"
JOIN = f"{SERVE}; from qdgrasp_worker.platform import platform; platform()"
"""All that comes before a worker asks to join: its imports, and the probes in their scene."""
HEAVY = {"coacd", "embreex", "matplotlib", "numba", "PIL", "ribs", "sklearn", "trimesh"}
"""What others need: meshes, pictures and searches; each takes a tenth of a second, some a whole one."""


def loaded(statements: str) -> set[str]:
    """The modules of a fresh interpreter after these statements."""
    command = [sys.executable, "-c", LISTED.format(statements)]
    said = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    return set(json.loads(said.splitlines()[-1]))


@pytest.fixture(scope="module")
def joining() -> set[str]:
    return loaded(JOIN)


def test_a_worker_that_joins_has_loaded_the_simulator_and_the_bus(joining):
    assert {"pybullet", "zenoh", "qdgrasp_worker.evaluate"} <= joining


def test_a_worker_that_joins_has_loaded_nothing_that_only_others_need(joining):
    assert not joining & HEAVY
    assert not [name for name in joining if name.startswith("qdgrasp_coordinator")]


def test_a_worker_can_be_asked_for_help_without_simulator_bus_and_arrays():
    assert not loaded("import qdgrasp_worker.cli") & {"numpy", "scipy", "pybullet", "zenoh"}
