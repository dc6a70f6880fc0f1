"""Clients without rights at a router, and probes that cannot decide."""

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import copytree

import pytest
from tests.tools.security.conftest import encrypted_endpoint

from qdgrasp_protocol.errors import EndpointError
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.security import access_probe, access_report
from qdgrasp_tools.security.access_list import access_list
from qdgrasp_tools.security.access_report import check_access, matrix_table, short_key

Rough = Callable[[socket.socket], None]


def resets(link: socket.socket) -> None:
    """End a link at once, without a word of TLS."""
    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    link.close()


def closes(link: socket.socket) -> None:
    """End a link at once, in good order."""
    link.close()


@contextmanager
def rough_router(how: Rough) -> Iterator[str]:
    """The endpoint of a router that ends every link."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    how(server.accept()[0])
                except OSError:
                    return

        threading.Thread(target=serve, daemon=True).start()
        yield f"tls/127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def short_login(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access_probe, "LOGIN_SECONDS", 0.3)


@pytest.mark.usefixtures("short_login")
@pytest.mark.parametrize("how", [resets, closes])
def test_a_router_that_takes_nobody_proves_nothing(folder: Path, how: Rough) -> None:
    with rough_router(how) as endpoint, pytest.raises(EndpointError, match="cannot be said") as caught:
        access_probe.try_logins(endpoint, folder)
    assert caught.value.exit_code == 2


@pytest.mark.usefixtures("short_login")
def test_a_router_that_is_away_proves_nothing(folder: Path) -> None:
    with pytest.raises(EndpointError, match="cannot be said"):
        access_probe.try_logins(encrypted_endpoint(), folder)


def test_a_link_that_is_ended_without_a_word_is_refused(secured, folder, monkeypatch) -> None:
    monkeypatch.setattr(access_probe, "LOGIN_SECONDS", 30.0)
    monkeypatch.setattr(access_probe, "shake_hands", lambda *_: False)
    assert not access_probe._greets(secured, folder)
    monkeypatch.setattr(access_probe, "shake_hands", lambda *_: True)
    assert access_probe._greets(secured, folder)


@pytest.mark.parametrize("through", [None, "tls/c:1,tls/d:1"])
def test_a_proof_is_of_one_router_at_a_time(folder: Path, through: str | None) -> None:
    several = "tls/a:1,tls/b:1"
    with pytest.raises(EndpointError, match="is not an endpoint"):
        check_access("tls/a:1" if through else several, folder, takers_at=through)


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Silence is short; what is to happen may take long on a busy machine."""
    monkeypatch.setattr(access_probe, "QUIET_SECONDS", 0.25)
    monkeypatch.setattr(access_probe, "DELIVERY_SECONDS", 30.0)
    monkeypatch.setattr(access_report, "SESSION_SECONDS", 30.0)


def test_every_cell_is_as_it_should_be_and_no_stranger_gets_in(secured: str, folder: Path) -> None:
    found = check_access(secured, folder)
    assert found.faults == []
    assert len(found.matrix) >= 600
    assert 70 <= sum(cell.is_allowed for cell in found.matrix) <= 90
    assert [login.got_in for login in found.logins] == [False] * 4
    assert not [cell for cell in found.matrix if cell.role == "guest" and cell.is_allowed]


def leaky(folder: Path, tmp_path: Path) -> Path:
    """The folder with an access list that has holes, and one right too few."""
    copy = copytree(folder, tmp_path / "leaky")
    written = access_list()
    rules = {rule["id"]: rule for rule in written["access_control"]["rules"]}
    jobs = "qdgrasp/v1/*"
    rules["worker gives (put)"]["key_exprs"].append(f"{jobs}/@work/*")
    rules["monitor takes (put)"]["key_exprs"].append(f"{jobs}/@result/*")
    rules["monitor is given (put)"]["key_exprs"].append(f"{jobs}/@result/*")
    rules["recorder gives (token)"]["key_exprs"].append(f"{jobs}/live/coord/*")
    rules["worker takes (put)"]["key_exprs"].append("qdgrasp/**")
    rules["worker is given (put)"]["key_exprs"].append("qdgrasp/**")
    rules["coordinator takes (query)"]["key_exprs"].remove(f"{jobs}/rpc/control")
    path = copy / "router.json5"
    tree = json.loads(
        "".join(line for line in path.read_text().splitlines(True) if not line.startswith("//"))
    )
    path.write_text(json.dumps(tree | written))
    return copy


def test_an_access_list_with_holes_is_found_out(folder, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(access_probe, "DELIVERY_SECONDS", 5.0)  # one right is missing, and waited for
    endpoint, place = encrypted_endpoint(), leaky(folder, tmp_path)
    with ZenohBus.router(endpoint, credentials=Credentials.find(place, Role.ROUTER)):
        found = check_access(endpoint, place)
    assert found.faults
    assert {(cell.role, cell.verb, short_key(cell.key)) for cell in found.matrix if cell.wrong} == {
        ("worker", "put", "@work/*"),
        ("monitor", "hear", "@result/*"),
        ("recorder", "live", "live/coord/*"),
        ("worker", "hear", "stat/worker/*"),
        ("worker", "hear", "stat/job"),
        ("worker", "hear", "stat/run/*"),
        ("worker", "hear", "stat/team/*"),
        ("worker", "hear", "event/*"),
        ("worker", "hear", "event/recent"),
        ("worker", "hear", "meta"),
        ("admin", "ask", "rpc/control"),
        ("coordinator", "answer", "rpc/control"),
    }
    assert any("worker, by a wide pattern" in words for words in found.wide)
    assert "WRONG" in matrix_table(found.matrix)


def test_a_router_that_is_not_there_is_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access_report, "SESSION_SECONDS", 0.3)
    with pytest.raises(EndpointError, match="Nothing answers at tls/"):
        check_access(encrypted_endpoint(), folder)


@pytest.mark.slow
def test_every_cell_is_as_it_should_be_through_two_routers(folder: Path) -> None:
    first, second = encrypted_endpoint(), encrypted_endpoint()
    shown = Credentials.find(folder, Role.ROUTER)
    with ZenohBus.router(first, credentials=shown), ZenohBus.router(second, connect=first, credentials=shown):
        found = check_access(first, folder, takers_at=second)
    assert found.faults == []
