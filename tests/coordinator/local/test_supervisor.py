"""Start and restart of the processes of a job on one machine."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from qdgrasp_coordinator.local import restart_policy, supervisor
from qdgrasp_coordinator.local.supervisor import ListenConfig, LocalJobConfig, Supervisor
from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.process import ProcessExit, Stop

CHOSEN = "tcp/127.0.0.1:50123"
"""Endpoint of a coordinator that was not given one."""


class Staff:
    """Processes by name: its first coordinator is killed, its second one gets done."""

    members_grace = 0.25

    def __init__(self, folder: JobFolder) -> None:
        self._folder = folder
        self._is_killed = False
        self.coordinators: list[list[str]] = []
        self.others: list[list[str]] = []

    def __call__(self, *_: object) -> "Staff":
        return self

    def __enter__(self) -> "Staff":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def start(self, name: str, _module: str, arguments: list[str]) -> None:
        if name != "coordinator":
            self.others.append(arguments)
            return
        self.coordinators.append(arguments)
        self._folder.write_endpoint(after("--listen", arguments) or CHOSEN)

    def exits(self) -> list[ProcessExit]:
        if len(self.coordinators) == 2:
            return [ProcessExit("coordinator", 0)]
        killed = [ProcessExit("coordinator", -9)] if self.others and not self._is_killed else []
        self._is_killed |= bool(killed)
        return killed

    def last_error(self, _name: str) -> str:
        return ""

    def restart_due(self, now: float) -> None:
        pass

    def request_stop(self) -> None:
        pass


class Silence:
    """A display that shows nothing."""

    def show(self, figures: JobStatus) -> None:
        pass

    def say(self, sentence: str) -> None:
        pass


def after(flag: str, arguments: list[str]) -> str | None:
    return arguments[arguments.index(flag) + 1] if flag in arguments else None


@pytest.mark.parametrize(
    ("listen", "again", "near"),
    [
        ("tls/0.0.0.0:7000", "tls/0.0.0.0:7000", "tls/127.0.0.1:7000"),
        ("tls/[::]:1,tls/10.0.0.1:2", "tls/[::]:1,tls/10.0.0.1:2", "tls/[::1]:1"),
        (None, CHOSEN, CHOSEN),
    ],
)
def test_a_coordinator_that_is_started_again_listens_where_the_first_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listen: str | None, again: str, near: str
) -> None:
    folder = JobFolder.create(tmp_path / "job", "mugs")
    staff = Staff(folder)
    monkeypatch.setattr(supervisor, "ProcessGroup", staff)
    monkeypatch.setattr(restart_policy, "back_off", lambda _: 0.0)
    monkeypatch.setattr(Supervisor, "_subscribe", lambda *_: nullcontext())
    Supervisor(folder, LocalJobConfig(1, listen=ListenConfig(listen)), Silence(), Stop()).run()
    assert [after("--listen", one) for one in staff.coordinators] == [listen, again]
    assert [after("--connect", one) for one in staff.others] == [near, near]
    assert [after("--grace", one) for one in staff.others] == [None, "0.25"]  # a recorder, a worker
