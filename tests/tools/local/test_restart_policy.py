"""Restarts after deaths among a job's processes."""

import signal
from math import inf
from pathlib import Path
from typing import Any

import pytest
from tests.deploy.commands import understood
from tests.tools.monitor.sample_jobs import figures

from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.supervisor import (
    GRACE_MARGIN,
    MOST_DEATHS,
    MOST_OUTSIDE_DEATHS,
    ChildProcess,
    ProcessExit,
    ProcessSupervisor,
    RestartPolicy,
)
from qdgrasp_tools.local.restart_policy import GRACE, JobRestarts, start_worker


class Staff(ProcessSupervisor):
    """Processes by name that die when they are told to, and start when they are due; and a display."""

    def __init__(self) -> None:
        super().__init__(None)
        self.started: list[str] = []
        self.said: list[str] = []
        self.now = 0.0
        self.watch = JobRestarts(self, self)  # type: ignore[arg-type]
        self._dead: list[ProcessExit] = []
        for name in ("coordinator", "recorder", "worker-0", "worker-1"):
            self._children[name] = StartedChild(name, self)

    def dies(self, name: str, code: int, words: str = "") -> None:
        """A process dies, and those that are due are started again."""
        self._children[name].restart_at = inf
        self._dead = [ProcessExit(name, code, words)]
        self.watch.check(self.now)

    def waits(self, seconds: float) -> None:
        self.now += seconds
        self.watch.check(self.now)

    def exits(self) -> list[ProcessExit]:
        dead, self._dead = self._dead, []
        return dead

    def say(self, sentence: str) -> None:
        self.said.append(sentence)


class StartedChild(ChildProcess):
    """A child that starts no process."""

    def __init__(self, name: str, staff: Staff) -> None:
        super().__init__(name, "", list, None, None, RestartPolicy())
        self._staff = staff

    def start(self, now: float) -> None:
        self.restart_at = None
        self._staff.started.append(self.name)


@pytest.fixture
def staff() -> Staff:
    return Staff()


@pytest.mark.parametrize("code", [-9, 1, 143])
def test_a_coordinator_that_ended_without_a_word_is_started_again_after_a_while(staff, code) -> None:
    staff.dies("coordinator", code)
    assert (staff.started, staff.watch.is_done) == ([], False)
    staff.waits(0.6)
    staff.waits(60)
    assert staff.started == ["coordinator"]
    assert "it is started again in 0.5 s" in staff.said[0]


def test_a_coordinator_that_is_done_ends_the_watch(staff: Staff) -> None:
    staff.dies("coordinator", 0)
    assert staff.watch.is_done
    staff.dies("worker-0", -9)
    staff.waits(60)
    assert staff.started == []


@pytest.mark.parametrize(
    ("code", "error"), [(0, EndedEarly), (1, EndedEarly), (2, InputError), (3, EndedEarly)]
)
def test_a_coordinator_that_ended_with_a_sentence_ends_the_job_with_it(code: int, error: type) -> None:
    with pytest.raises(error, match=r"^Job 'mugs' was cancelled\.$") as raised:
        Staff().dies("coordinator", code, "Job 'mugs' was cancelled.")
    assert raised.value.exit_code > 0  # the job is not done


@pytest.mark.parametrize("name", ["coordinator", "recorder", "worker-1"])
@pytest.mark.parametrize(
    ("number", "most"), [(signal.SIGSEGV, MOST_DEATHS), (signal.SIGKILL, MOST_OUTSIDE_DEATHS)]
)
def test_who_dies_again_and_again_ends_the_job_later_if_killed_by_others(staff, name, number, most) -> None:
    for _ in range(most):
        staff.dies(name, -number)
        staff.waits(20)
    with pytest.raises(EndedEarly, match=f"The {name} died {most + 1} times .* was killed by {number.name}"):
        staff.dies(name, -number)


def test_who_dies_while_the_job_goes_on_is_always_started_again(staff: Staff) -> None:
    for n in range(10 * MOST_DEATHS):
        staff.watch.note_progress(figures(evaluations=n, rate=1.0))
        staff.dies("coordinator", -9)
        staff.waits(20)
    assert len(staff.started) == 10 * MOST_DEATHS


def test_a_worker_that_ended_well_was_asked_to_leave_and_stays_away(staff: Staff) -> None:
    staff.dies("worker-0", 0)
    staff.waits(60)
    assert (staff.started, staff.said) == ([], ["worker-0 has left"])


def test_a_member_that_names_bad_input_ends_the_job_unless_the_coordinator_is_away(staff: Staff) -> None:
    with pytest.raises(InputError, match="Another platform"):
        staff.dies("worker-0", 2, "Another platform.")
    staff.dies("coordinator", -9)
    staff.dies("worker-0", 2, "Nothing answers at tcp/127.0.0.1:1.")
    staff.waits(0.6)
    assert set(staff.started) == {"worker-0", "coordinator"}


class StartedProcesses(ProcessSupervisor):
    """A group that notes the arguments of its processes, and starts no process."""

    def start(self, name: str, module: str, arguments: Any, core: int | None = None) -> None:
        self.command = ["qdgrasp-worker", *arguments()]


@pytest.mark.parametrize("grace", [0.25, GRACE, 60.0])
def test_a_worker_is_told_to_leave_before_its_crew_ends_it(tmp_path: Path, grace: float) -> None:
    staff = StartedProcesses(tmp_path, grace)
    start_worker(staff, 0, lambda: ["--connect", "tcp/127.0.0.1:7447"])
    assert understood(staff.command)["grace"] == pytest.approx(max(0.0, grace - GRACE_MARGIN))
