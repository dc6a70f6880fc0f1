"""A server of the page, with jobs made by hand behind it."""

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from queue import Queue
from typing import Any

import pytest
from starlette.testclient import TestClient
from tests import browser
from tests.common import PATIENCE
from tests.coordinator.monitor.web.fakes import FakeFeed, FakeLibrary

from qdgrasp_coordinator.monitor.web.access import Access
from qdgrasp_coordinator.monitor.web.routes import Site, live_site
from qdgrasp_coordinator.monitor.web.run_cache import RunCaches
from qdgrasp_coordinator.monitor.web.server import application, serve
from qdgrasp_protocol.process import Stop

HERE = "127.0.0.1"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser for the tests of a module, which are skipped where there is none."""
    with browser.launched() as launched:
        yield launched


@pytest.fixture
def look(chromium: Any) -> Iterator[Callable[..., Any]]:
    """Opens a page; whatever it complains of fails the test."""
    visits: list[browser.Visit] = []

    def opened(address: str, **looks: Any) -> Any:
        visits.append(browser.Visit(chromium, address, **looks))
        return visits[-1].page

    yield opened
    for visit in visits:
        visit.context.close()
    assert [words for visit in visits for words in visit.complaints] == []


@pytest.fixture
def feed() -> FakeFeed:
    """Jobs that have done a little."""
    made = FakeFeed()
    for _ in range(3):
        made.step()
    return made


def client(feed: FakeFeed, access: Access | None = None) -> TestClient:
    """A client on this machine."""
    app = application(live_site(feed, FakeLibrary()), access or Access(local=True))
    return TestClient(app, base_url="http://localhost:8080", follow_redirects=False)


def serving(
    feed: FakeFeed, port: int, token: str = "", library: FakeLibrary | RunCaches | None = None
) -> AbstractContextManager[str]:
    """A server of a live page in a thread; gives its address, and ends it in the end."""
    return serving_site(live_site(feed, library or FakeLibrary()), port, token)


@contextmanager
def serving_site(site: Site, port: int, token: str = "") -> Iterator[str]:
    """The same of any site."""
    stop, open_at = Stop(), Queue[str]()
    thread = threading.Thread(target=serve, args=(site, HERE, port, token, stop, open_at.put))
    thread.start()
    try:
        assert open_at.get(timeout=PATIENCE).startswith(f"http://{HERE}:{port}/")
        yield f"http://{HERE}:{port}"
    finally:
        stop.set(15)
        thread.join(PATIENCE)
        assert not thread.is_alive(), "the server did not end"
