"""A server of the page, with jobs made by hand behind it."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from starlette.testclient import TestClient
from tests.coordinator.monitor.web.fakes import FakeFeed, FakeLibrary

from qdgrasp_coordinator.monitor.web.access import Access
from qdgrasp_coordinator.monitor.web.app import application, serve
from qdgrasp_coordinator.monitor.web.broadcast import Broadcast
from qdgrasp_coordinator.monitor.web.libraries import Library
from qdgrasp_coordinator.monitor.web.showing import Showing
from qdgrasp_protocol.lifetime import Stop

HERE = "127.0.0.1"


@pytest.fixture
def feed() -> FakeFeed:
    """Jobs that have done a little."""
    made = FakeFeed()
    for _ in range(3):
        made.step()
    return made


def client(feed: FakeFeed, access: Access | None = None) -> TestClient:
    """A client on this machine."""
    shown = Showing(feed)
    app = application(shown, FakeLibrary(), access or Access(local=True), Broadcast(shown.state))
    return TestClient(app, base_url="http://localhost:8080", follow_redirects=False)


def free_port() -> int:
    with socket.create_server((HERE, 0)) as found:
        port: int = found.getsockname()[1]
        return port


@contextmanager
def serving(feed: FakeFeed, port: int, token: str = "", library: Library | None = None) -> Iterator[str]:
    """A server in a thread; gives its address, and ends it in the end."""
    stop = Stop()
    shown = library or FakeLibrary()
    thread = threading.Thread(target=serve, args=(feed, shown, HERE, port, token, stop))
    thread.start()
    try:
        with _reached(port):
            yield f"http://{HERE}:{port}"
    finally:
        stop.set(15)
        thread.join(20)
        assert not thread.is_alive(), "the server did not end"


def _reached(port: int) -> socket.socket:
    """A connection to the server, as soon as it listens."""
    while True:
        try:
            return socket.create_connection((HERE, port), timeout=30)
        except ConnectionRefusedError:
            threading.Event().wait(0.02)
