"""Processes of two versions of the protocol beside each other, and a job that goes on in the next one."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.chaos.processes import JOB, JobProcesses, Process
from tests.common import wait_for
from tests.system.commands import BUDGET, COORDINATOR, RECORDER, WORKER

from qdgrasp_coordinator.scheduler.run_plan import RUN_DEFAULTS, full_spec
from qdgrasp_protocol.messages import VERSION

NEXT = VERSION + 1
SPEC = full_spec(
    RUN_DEFAULTS | {"gripper": "panda", "object": "tennis_ball", "population": 60, "evaluations": BUDGET}
)
"""The run of which `long_digest` is the digest."""


class TwoVersions(JobProcesses):
    """The processes of a job, each in this version, or the next one."""

    def __init__(self, home: Path) -> None:
        super().__init__(home, SPEC, workers=1)
        there = ["--connect", self.endpoint]
        for name, module, arguments in (
            ("coordinator", COORDINATOR, [self.run]),
            ("recorder", RECORDER, ["--job", JOB, "--out", self.run]),
            ("worker-0", WORKER, ["--job", JOB]),
        ):
            self.add(f"next-{name}", "tests.fakes.next_version", module, *arguments, *there)

    def begin(self, *names: str) -> list[Process]:
        """Start processes; gives them in this order."""
        found = [self[name] for name in names]
        for process in found:
            process.start()
        return found


@pytest.fixture
def job(tmp_path: Path) -> Iterator[TwoVersions]:
    with TwoVersions(tmp_path) as processes:
        processes.begin("router")
        yield processes


def ends(process: Process) -> str:
    """Wait until a process has ended by itself with exit code 2; gives what it said."""
    wait_for(lambda: process.exit_code is not None, f"the end of {process.name}")
    assert process.exit_code == 2, process.words
    assert "Traceback" not in process.words
    return process.words


def test_a_worker_of_the_next_version_is_refused_by_a_coordinator_of_this_one(job: TwoVersions) -> None:
    *_, worker = job.begin("recorder", "coordinator", "next-worker-0")
    assert f"it speaks versions [{NEXT}] of the protocol, this job speaks {VERSION}" in ends(worker)
