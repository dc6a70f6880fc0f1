"""`qdgrasp-recorder` as a process of its own, over zenoh."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest
from tests.common import PATIENCE, own_endpoint
from tests.fakes.recorder import BUNDLE, JOB, SPEC, FakeCoordinator, make_rows

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.zenoh_bus import ZenohBus


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "run", SPEC, BUNDLE, job=JOB)


@pytest.fixture
def endpoint() -> str:
    return own_endpoint()


@pytest.fixture
def router(endpoint: str) -> Iterator[ZenohBus]:
    with ZenohBus.router(endpoint) as bus:
        yield bus


@contextmanager
def recorder(
    endpoint: str, path: Path, *more: str, stderr: IO[bytes] | int = subprocess.PIPE
) -> Iterator["subprocess.Popen[bytes]"]:
    arguments = ["--connect", endpoint, "--job", JOB, "--out", str(path), *more]
    command = [sys.executable, "-m", "qdgrasp_tools.cli.job_processes", "recorder", *arguments]
    with subprocess.Popen(command, stderr=stderr) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_signal_ends_it_with_its_code_and_a_kill_loses_nothing_durable(endpoint, router, folder) -> None:
    coordinator, rows = FakeCoordinator(router), make_rows(2000)
    for turn, (number, code) in enumerate(
        [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)]
    ):
        with recorder(endpoint, folder.path) as process:
            assert coordinator.open().durable == [500 * turn]
            coordinator.send(rows, 500 * turn, 500 * turn + 500)
            coordinator.hears_durable(500 * turn + 500)
            os.kill(process.pid, number)
            assert process.wait(PATIENCE) == code
    with folder.journal() as journal:
        assert journal.slice(0, 2000).rows.tobytes() == rows[:1500].tobytes()
