"""Who knocks at a router, and when it cannot be said that nobody got in."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.coordinator.security.conftest import encrypted_endpoint

from qdgrasp_coordinator.security import access_probe
from qdgrasp_coordinator.security.access_report import check_access
from qdgrasp_protocol.errors import EndpointError

Rough = Callable[[socket.socket], None]


def resets(link: socket.socket) -> None:
    """End a link at once, without a word of TLS."""
    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    link.close()


def closes(link: socket.socket) -> None:
    """End a link at once, in good order."""
    link.close()


@contextmanager
def router(how: Rough) -> Iterator[str]:
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


@pytest.fixture(autouse=True)
def brisk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access_probe, "LOGIN_SECONDS", 0.3)


@pytest.mark.parametrize("how", [resets, closes])
def test_a_router_that_takes_nobody_proves_nothing(folder: Path, how: Rough) -> None:
    with router(how) as endpoint, pytest.raises(EndpointError, match="cannot be said") as caught:
        access_probe.try_logins(endpoint, folder)
    assert caught.value.exit_code == 2


def test_a_router_that_is_away_proves_nothing(folder: Path) -> None:
    with pytest.raises(EndpointError, match="cannot be said"):
        access_probe.try_logins(encrypted_endpoint(), folder)


def test_a_link_that_is_ended_without_a_word_is_refused(
    secured: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
