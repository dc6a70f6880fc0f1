"""Connections on which nothing is asked do not shut the page."""

import socket
import threading
from http.client import HTTPConnection
from urllib.request import urlopen

import pytest
from tests.coordinator.monitor.web.conftest import HERE, free_port, serving
from tests.coordinator.monitor.web.fakes import FakeFeed
from tests.patience import PATIENCE

from qdgrasp_coordinator.monitor.web import app, visit


def ended(connection: socket.socket) -> bool:
    """Whether the server ends a connection; False: it said something."""
    connection.settimeout(PATIENCE)
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.mark.parametrize("begun", [b"", b"GET /api/sta", b"GET / HTTP/1.1\r\nHost: localhost\r\nA: "])
def test_whoever_asks_nothing_is_let_go(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch, begun: bytes
) -> None:
    monkeypatch.setattr(visit, "SOON", 0.2)
    port = free_port()
    with serving(feed, port), socket.create_connection((HERE, port)) as idle:
        idle.sendall(begun)
        assert ended(idle)


def test_a_stream_that_was_asked_for_goes_on(feed: FakeFeed, monkeypatch: pytest.MonkeyPatch) -> None:
    looked, leave = threading.Event(), visit.Visit.leave

    def leave_later(self: visit.Visit) -> None:
        """Look whether something was asked when it was: on a busy machine a question may be late."""
        if self.cycle is None:
            self.loop.call_later(0.01, self.leave)
        else:
            leave(self)
            looked.set()

    monkeypatch.setattr(visit, "SOON", 0.1)
    monkeypatch.setattr(visit.Visit, "leave", leave_later)
    with serving(feed, free_port()) as address:
        stream = urlopen(f"{address}/api/stream", timeout=PATIENCE)  # noqa: S310 - our own
        assert looked.wait(PATIENCE)
        frames = [line for line in (stream.readline() for _ in range(12)) if line.startswith(b"data: ")]
        stream.close()
    assert len(frames) >= 3


def test_one_address_does_not_take_the_room_of_others(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visit, "GUESTS", 4)
    port = free_port()
    with serving(feed, port) as address:
        crowd = [socket.create_connection((HERE, port)) for _ in range(8)]
        assert ended(crowd[-1])
        with pytest.raises(OSError, match=r"."):
            urlopen(f"{address}/api/state", timeout=PATIENCE)  # noqa: S310 - our own
        with socket.create_connection((HERE, port), source_address=("127.0.0.2", 0)) as other:
            other.sendall(b"GET /api/state HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert not ended(other)
        for one in crowd:
            one.close()


def test_whoever_comes_to_a_full_house_is_asked_to_try_again(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "CONNECTIONS", 4)
    port = free_port()
    with serving(feed, port):
        guests = [HTTPConnection(HERE, port, timeout=PATIENCE) for _ in range(4)]
        assert [asked(guest) for guest in guests] == [200, 200, 200, 503]
        for guest in guests:
            guest.close()


def asked(guest: HTTPConnection) -> int:
    """What a connection is answered with that stays there afterwards."""
    guest.request("GET", "/api/state")
    answer = guest.getresponse()
    answer.read()
    return answer.status
