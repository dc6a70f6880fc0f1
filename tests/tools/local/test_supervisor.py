"""Start, watch and restart of the processes of a job on one machine."""

import signal
from math import inf
from pathlib import Path
from typing import Any

import pytest
from tests.tools.monitor.sample_jobs import figures

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.errors import EndedEarly, EndpointError, InputError
from qdgrasp_protocol.process import (
    MOST_DEATHS,
    MOST_OUTSIDE_DEATHS,
    ChildProcess,
    ProcessExit,
    ProcessSupervisor,
    RestartPolicy,
    Stop,
)
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.local import supervisor
from qdgrasp_tools.local.supervisor import JobProcesses, LocalJobConfig, Supervisor


class Staff(ProcessSupervisor):
    """Processes by name that die when they are told to, and start when they are due; and a display."""

    def __init__(self) -> None:
        super().__init__(None)
        self.started: list[str] = []
        self.said: list[str] = []
        self.now = 0.0
        self.watch = JobProcesses(self, self, "mugs", "")  # type: ignore[arg-type]
        self._dead: list[ProcessExit] = []
        for name in ("coordinator", "recorder", "worker-0", "worker-1"):
            self._children[name] = StartedChild(name, self)

    def dies(self, name: str, code: int, words: str = "", last_line: str = "") -> None:
        """A process dies, and those that are due are started again."""
        self._children[name].restart_at = inf
        self._dead = [ProcessExit(name, code, words, last_line)]
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
        super().__init__(name, "", list, None, RestartPolicy())
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


def test_who_fails_twice_for_the_same_reason_without_progress_ends_the_job_with_it(staff: Staff) -> None:
    for line, evaluations in [("KeyError: 1", 1), ("KeyError: 2", 2), ("KeyError: 1", 2), ("KeyError: 2", 2)]:
        staff.watch.note_progress(figures(evaluations=evaluations, rate=1.0))
        staff.dies("recorder", 1, last_line=line)
        staff.waits(60)
    assert "(KeyError: 2)" in staff.said[-1]
    staff.dies("recorder", -9)
    with pytest.raises(InputError, match=r"recorder ended with exit code 1 twice .*: KeyError: 2$"):
        staff.dies("recorder", 1, last_line="KeyError: 2")


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


CHOSEN = "tcp/127.0.0.1:50123"
"""Endpoint of a coordinator that was not given one."""


class ListeningJob(ProcessSupervisor):
    """Processes of which the coordinator listens, is killed once the others are there, and then is done."""

    def __init__(self, folder: JobFolder) -> None:
        super().__init__(None, 0.75)
        self._folder = folder
        self._ends = [-9, 0]
        self.coordinators: list[list[str]] = []
        self.others: list[list[str]] = []

    def start(self, name: str, _module: str, arguments: Any) -> None:
        if name != "coordinator":
            self.others.append(arguments())
            return
        self._arguments = arguments
        self.coordinators.append(arguments())
        self._folder.write_endpoint(after("--listen", self.coordinators[-1]) or CHOSEN)

    def exits(self) -> list[ProcessExit]:
        return [ProcessExit("coordinator", self._ends.pop(0))] if self.others and self._ends else []

    def restart_later(self, death: ProcessExit, now: float) -> float:
        return 0.0

    def restart_due(self, now: float) -> None:
        if len(self._ends) == 1 == len(self.coordinators):
            self.start("coordinator", "", self._arguments)


def after(flag: str, arguments: list[str]) -> str | None:
    return arguments[arguments.index(flag) + 1] if flag in arguments else None


@pytest.mark.parametrize(
    ("listen", "again"),
    [("tls/[::]:1,tls/10.0.0.1:2", "tls/[::]:1,tls/10.0.0.1:2"), (None, CHOSEN)],
)
def test_a_coordinator_that_is_started_again_listens_where_the_first_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listen: str | None, again: str
) -> None:
    folder = JobFolder.create(tmp_path / "job", "mugs")
    job = ListeningJob(folder)

    def refuse(*_: object) -> None:
        raise EndpointError("Nothing answers.")

    monkeypatch.setattr(supervisor, "ProcessSupervisor", lambda *_: job)
    monkeypatch.setattr(ZenohBus, "connect", refuse)
    Supervisor(folder, LocalJobConfig(1, listen), Staff(), Stop()).run()  # type: ignore[arg-type]
    assert [after("--listen", one) for one in job.coordinators] == [listen, again]
    assert [after("--connect", one) for one in job.others] == [str(folder.path / "endpoint")] * 2
    assert [after("--grace", one) for one in job.others] == ["0.25", None]  # a worker, a recorder
