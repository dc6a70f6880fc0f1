"""Start and restart of the processes of a job on one machine."""

import re
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.errors import EndpointError, InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.supervisor import ProcessExit, ProcessSupervisor
from qdgrasp_tools.local import supervisor
from qdgrasp_tools.local.supervisor import ListenConfig, LocalJobConfig, Supervisor

CHOSEN = "tcp/127.0.0.1:50123"
"""Endpoint of a coordinator that was not given one."""


KILLED, DONE = (-9, ""), (0, "")
TAKEN = (2, "Cannot listen on tcp/127.0.0.1:1: address already in use; name another endpoint with --listen.")


class Staff(ProcessSupervisor):
    """Processes by name; each coordinator ends as `ends` says, the first when the others are there."""

    def __init__(self, folder: JobFolder, *ends: tuple[int, str]) -> None:
        super().__init__(None, 0.75)
        self._folder = folder
        self._ends = ends
        self._ended = 0
        self._arguments: dict[str, Callable[[], list[str]]] = {}
        self.coordinators: list[list[str]] = []
        self.others: list[list[str]] = []
        self.moved: list[str] = []

    def __call__(self, *_: object) -> "Staff":
        return self

    def start(self, name: str, _module: str, arguments: Callable[[], list[str]]) -> None:  # type: ignore[override]
        self._arguments[name] = arguments
        if name != "coordinator":
            self.others.append(list(arguments()))
            return
        self.coordinators.append(arguments())
        if self._ends[self._ended] != TAKEN:
            self._folder.write_endpoint(after("--listen", self.coordinators[-1]) or CHOSEN)

    def restart_others(self, _name: str) -> None:
        self.moved += [after("--connect", list(self._arguments["recorder"]())) or ""]

    def exits(self) -> list[ProcessExit]:
        is_first = not self.others and self._ends[0] != TAKEN
        if is_first or self._ended == len(self.coordinators):
            return []
        self._ended += 1
        return [ProcessExit("coordinator", *self._ends[self._ended - 1])]

    def is_dead(self, name: str) -> bool:
        return name == "coordinator" and self._ended == len(self.coordinators)

    def restart_later(self, death: ProcessExit, now: float) -> float:
        return 0.0

    def restart_due(self, now: float) -> None:
        if self.is_dead("coordinator") and self._ended < len(self._ends):
            self.start("coordinator", "", self._arguments["coordinator"])


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
    staff = carries_out(tmp_path, monkeypatch, listen, KILLED, DONE)
    assert [after("--listen", one) for one in staff.coordinators] == [listen, again]
    assert [after("--connect", one) for one in staff.others] == [near, near]
    assert [after("--grace", one) for one in staff.others] == [None, "0.25"]  # a recorder, a worker
    assert staff.moved == []


class Session:
    """A session that hears no figures; `open` is called with its endpoint and the supervisor's news."""

    def __init__(self, opened: Callable[[str, Callable], object]) -> None:
        self._opened = opened

    def __call__(self, _job: object, _credentials: object, news: object) -> "Session":
        self._put = news.put  # type: ignore[attr-defined]
        return self

    def open(self, endpoint: str) -> None:
        self._opened(endpoint, self._put)

    def close(self) -> None:
        pass


def carries_out(
    home: Path,
    monkeypatch: pytest.MonkeyPatch,
    listen: str | None,
    *ends: tuple[int, str],
    opened: Callable[[str, Callable], object] = lambda *_: None,
    display: Silence | None = None,
) -> Staff:
    """Carry out a job whose coordinators end so."""
    folder = JobFolder.create(home / "job", "mugs")
    staff = Staff(folder, *ends)
    monkeypatch.setattr(supervisor, "ProcessSupervisor", staff)
    monkeypatch.setattr(supervisor, "FiguresSession", Session(opened))
    config = LocalJobConfig(1, listen=ListenConfig(listen))
    Supervisor(folder, config, display or Silence(), Stop()).run()
    return staff


def test_a_job_whose_port_was_taken_meanwhile_goes_on_at_another_one(tmp_path, monkeypatch) -> None:
    opened: list[str] = []
    said: list[str] = []
    display = Silence()
    display.say = said.append  # type: ignore[method-assign]
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        asked = f"tcp/127.0.0.1:{port}"
        staff = carries_out(
            tmp_path,
            monkeypatch,
            asked,
            KILLED,
            TAKEN,
            DONE,
            opened=lambda at, _: opened.append(at),
            display=display,
        )
    first, second, third = (after("--listen", one) for one in staff.coordinators)
    assert (first, second) == (asked, asked)
    assert third != asked
    assert re.fullmatch(r"tcp/127\.0\.0\.1:[1-9]\d+", third or "")
    assert staff.moved == [third]
    assert opened == [asked, third]
    assert any(f"listening on {third} now, as another program took the port" in line for line in said)


def test_a_port_that_is_taken_from_the_start_ends_the_job(tmp_path, monkeypatch) -> None:
    with pytest.raises(InputError, match="address already in use"):
        carries_out(tmp_path, monkeypatch, "tcp/127.0.0.1:1", TAKEN)


def test_a_session_that_failed_at_a_coordinator_that_died_is_opened_at_the_next(tmp_path, monkeypatch):
    opened: list[str] = []

    def fail_once(endpoint: str, put: Callable) -> None:
        opened.append(endpoint)
        if len(opened) == 1:
            put(EndpointError("Nothing answers."))

    carries_out(tmp_path, monkeypatch, None, KILLED, DONE, opened=fail_once)
    assert opened == [CHOSEN, CHOSEN]
