"""The stream over real connections."""

import json
import socket
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse

import pytest
from tests.coordinator.monitor.web.conftest import HERE, free_port, serving
from tests.coordinator.monitor.web.fakes import FakeFeed, FakeLibrary
from tests.patience import PATIENCE

from qdgrasp_coordinator.monitor.web.app import serve
from qdgrasp_coordinator.monitor.web.broadcast import MOST
from qdgrasp_coordinator.monitor.web.live_site import LiveSite
from qdgrasp_protocol.errors import EndpointError
from qdgrasp_protocol.lifetime import Stop


def opened(stack: ExitStack, port: int) -> HTTPResponse:
    connection = HTTPConnection(HERE, port, timeout=PATIENCE)
    stack.callback(connection.close)
    connection.request("GET", "/api/stream")
    return connection.getresponse()


def states(answer: HTTPResponse, number: int) -> list[dict[str, object]]:
    found = []
    while len(found) < number:
        line = answer.readline()
        if line.startswith(b"data: "):
            found.append(json.loads(line[6:]))
    return found


def test_the_stream_tells_what_changes(feed: FakeFeed) -> None:
    port = free_port()
    with serving(feed, port), ExitStack() as stack:
        answer = opened(stack, port)
        assert answer.headers["content-type"].startswith("text/event-stream")
        first = states(answer, 1)[0]
        feed.step()
        second = states(answer, 1)[0]
        while second == first:
            second = states(answer, 1)[0]
    evaluations = [state["jobs"][1]["figures"]["evaluations"] for state in (first, second)]  # type: ignore[index]
    assert evaluations[0] < evaluations[1]


def test_there_is_room_for_so_many_browsers_and_again_when_one_leaves(feed: FakeFeed) -> None:
    port = free_port()
    with serving(feed, port), ExitStack() as stack:
        leaver = ExitStack()
        answers = [opened(leaver, port), *(opened(stack, port) for _ in range(MOST - 1))]
        for answer in answers:
            states(answer, 1)
        refused = opened(stack, port)
        assert (refused.status, refused.headers["retry-after"]) == (503, "5")
        leaver.close()
        while opened(stack, port).status != 200:
            states(answers[1], 1)


def test_a_browser_that_reads_nothing_holds_up_nobody_and_not_the_end(feed: FakeFeed) -> None:
    port = free_port()
    with serving(feed, port), ExitStack() as stack:
        stuck = stack.enter_context(socket.create_connection((HERE, port)))
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        stuck.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert len(states(opened(stack, port), 4)) == 4


def test_a_place_that_is_taken_is_said(feed: FakeFeed) -> None:
    with socket.create_server((HERE, 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(EndpointError, match=f"{HERE}:{port}: Address already in use; name another place"):
            serve(LiveSite(feed, FakeLibrary()), HERE, port, "", Stop(), print)
