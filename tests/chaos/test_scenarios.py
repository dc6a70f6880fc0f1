"""Special failures of real processes: the run ends as it would have without them."""

import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.chaos.plan import RunKind
from tests.chaos.play import undisturbed_digest
from tests.chaos.processes import JobProcesses
from tests.chaos.simulator import FAILURES, FAILURES_VARIABLE
from tests.common import wait_for
from tests.system.commands import digest_of

from qdgrasp_coordinator.storage.outputs import JOURNAL
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import TookOver

RUN_KIND = RunKind("contact_rand", "paper", 60, 0.05)
SPEC = RUN_KIND.spec(seed=4, evaluations=300)
"""The run of test_chaos too, which is carried out undisturbed for both."""
EARLY = 60  # rows that are recorded when it happens

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


@pytest.fixture(scope="session")
def expected(undisturbed: Path) -> str:
    return undisturbed_digest(SPEC, undisturbed)


@pytest.fixture
def job(tmp_path: Path) -> Iterator[JobProcesses]:
    """A job in progress, with some rows recorded."""
    with JobProcesses(tmp_path, SPEC, workers=4, row_seconds=RUN_KIND.row_seconds) as job:
        job.start()
        wait_for(lambda: job.rows >= EARLY, "the first rows")
        assert job["coordinator"].is_there
        yield job


def ends_well(job: JobProcesses, coordinator: str = "coordinator") -> str:
    """Wait until a job is over; gives its digest."""
    process = job[coordinator]
    wait_for(lambda: process.exit_code is not None, "the end")
    assert process.exit_code == 0, process.words
    assert job.end() == []
    assert not [member.name for member in job if "Traceback" in member.words]
    return digest_of(job.run)


def cut(wal: Path) -> None:
    """Cut off the end of the last page."""
    with wal.open("r+b") as file:
        file.truncate(wal.stat().st_size - 1000)


def garble(wal: Path) -> None:
    """Overwrite the last page."""
    with wal.open("r+b") as file:
        file.seek(-1000, 2)
        file.write(bytes(1000))


@pytest.mark.parametrize("tear", [cut, garble])
def test_a_recorder_whose_last_page_is_torn_gets_what_it_lost_again(job, expected, tear) -> None:
    recorder = job["recorder"]
    recorder.send(signal.SIGKILL)
    before = job.rows
    tear(job.run / f"{JOURNAL}-wal")
    assert job.rows < before
    recorder.start()
    assert ends_well(job) == expected


def test_a_disk_that_is_full_for_a_while_is_waited_for(job: JobProcesses, expected: str) -> None:
    recorder = job["recorder"]
    largest = max(file.stat().st_size for file in job.run.glob(f"{JOURNAL}*"))
    _, most = resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (largest, most))
    wait_for(lambda: "the disk is full" in recorder.words, "a full disk")
    rows = job.rows
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (most, most))
    wait_for(lambda: "there is room again" in recorder.words, "room")
    assert rows < SPEC.evaluations
    assert ends_well(job) == expected


def test_the_head_and_half_of_the_workers_are_killed_at_once(job: JobProcesses, expected: str) -> None:
    for name in ("coordinator", "recorder", "worker-0", "worker-1"):
        job[name].send(signal.SIGKILL)
    job.start()
    assert ends_well(job) == expected


def test_a_coordinator_that_stood_still_gives_way_to_its_successor(job, expected) -> None:
    first, second = job["coordinator"], job.another("coordinator")
    first.send(signal.SIGSTOP)
    second.start()
    wait_for(lambda: "worker joined" in second.words, "workers at the second coordinator")
    first.send(signal.SIGCONT)
    wait_for(lambda: first.exit_code is not None, "the end of the first coordinator")
    assert first.exit_code == TookOver.exit_code, first.words
    assert "took over (epoch 2)" in first.last_words
    assert ends_well(job, "coordinator-2") == expected
    assert RunFolder.open(job.run).job.epoch == 2


def test_a_recorder_that_stands_still_keeps_its_folder_and_goes_on(job, expected) -> None:
    first, second = job["recorder"], job.another("recorder")
    first.send(signal.SIGSTOP)
    second.start()
    wait_for(lambda: second.exit_code is not None, "the second recorder's refusal")
    assert second.exit_code == 2
    assert f"is in use by process {first.pid}" in second.last_words
    first.send(signal.SIGCONT)
    assert ends_well(job) == expected


def test_simulators_that_abort_hang_or_take_all_memory_cost_nothing_but_time(tmp_path, expected) -> None:
    failures = tmp_path / "failures"
    failures.mkdir()
    environment = {FAILURES_VARIABLE: str(failures)}
    limits = ("--row-seconds", 1, "--memory", 400)
    with JobProcesses(tmp_path, SPEC, workers=2, options=limits, **environment) as job:
        job.start()
        assert ends_well(job) == expected
    assert {failure.name for failure in failures.iterdir()} == set(FAILURES)
