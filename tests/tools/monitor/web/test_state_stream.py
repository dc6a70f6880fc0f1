"""Server-sent events, by themselves and over real connections."""

import asyncio
import json
import socket
import zlib
from collections.abc import Callable, Coroutine
from contextlib import ExitStack
from functools import wraps
from http.client import HTTPConnection, HTTPResponse
from itertools import count
from typing import Any

import msgspec
import pytest
from starlette.types import Message
from tests.common import PATIENCE, free_port
from tests.tools.monitor import sample_jobs
from tests.tools.monitor.web.conftest import HERE, FakeFeed, FakeLibrary, serving

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_protocol.errors import EndpointError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_tools.monitor.job_view import JobView
from qdgrasp_tools.monitor.web import state_stream
from qdgrasp_tools.monitor.web.routes import live_site
from qdgrasp_tools.monitor.web.server import serve
from qdgrasp_tools.monitor.web.state_stream import Broadcast, JobState, PageState

SCOPE = {"type": "http", "asgi": {"spec_version": "2.3"}, "method": "GET", "headers": []}


class States:
    """States that count how often one was made."""

    def __init__(self) -> None:
        self.made = 0

    def __call__(self) -> bytes:
        self.made += 1
        return b"%d" % self.made


def in_loop(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run a coroutine as a test, for so long at most."""

    @wraps(test)
    def run(*args: Any, **named: Any) -> None:
        asyncio.run(asyncio.wait_for(test(*args, **named), PATIENCE))

    return run


@in_loop
async def test_a_state_is_made_once_for_all_who_watch() -> None:
    states = States()
    shown = Broadcast(states, 60)
    watching = [shown.frames() for _ in range(20)]
    seen = await asyncio.gather(*(anext(each) for each in watching))
    assert {frame.plain for frame in seen} == {b"id: 1\ndata: 1\n\n"}
    assert states.made == 1
    shown.end()


@in_loop
async def test_who_is_slow_misses_frames_and_gets_the_newest() -> None:
    shown = Broadcast(States(), 0.001)
    slow, quick = shown.frames(), shown.frames()
    first = await anext(slow)
    for _ in range(50):
        latest = await anext(quick)
    assert (await anext(slow)).number >= latest.number > first.number + 40
    shown.end()


@in_loop
async def test_while_nobody_watches_nothing_is_made() -> None:
    states = States()
    shown = Broadcast(states, 0.001)
    watching = shown.frames()
    await anext(watching)
    await watching.aclose()
    assert shown.watchers == 0
    while shown._maker:
        await asyncio.sleep(0.001)
    made = states.made
    await asyncio.sleep(0.05)
    assert states.made == made
    again = shown.frames()
    assert (await anext(again)).number == made + 1
    shown.end()


@in_loop
async def test_whoever_begins_to_watch_gets_no_old_frame() -> None:
    states = States()
    shown = Broadcast(states, 0.001)
    for _ in range(3):
        watching = shown.frames()
        frame = await anext(watching)
        assert frame.plain == b"id: %d\ndata: %d\n\n" % (frame.number, frame.number)
        await watching.aclose()
        while shown._maker:
            await asyncio.sleep(0.001)
    assert states.made >= 3
    shown.end()


@in_loop
async def test_the_end_lets_everybody_go() -> None:
    shown = Broadcast(States(), 60)
    watching = [shown.frames() for _ in range(3)]
    for each in watching:
        await anext(each)
    waiting = [asyncio.ensure_future(anext(each)) for each in watching]
    await asyncio.sleep(0)
    shown.end()
    ended = await asyncio.gather(*waiting, return_exceptions=True)
    assert [type(each) for each in ended] == [StopAsyncIteration] * 3
    assert shown.watchers == 0


@in_loop
async def test_after_a_state_that_could_not_be_made_the_next_one_who_watches_gets_one() -> None:
    number = count()

    def state() -> bytes:
        if next(number) == 0:
            raise OSError
        return b"good"

    shown = Broadcast(state, 0.001)
    hung = asyncio.ensure_future(anext(shown.frames()))
    await asyncio.sleep(0)
    assert shown._maker
    while shown._maker:
        await asyncio.sleep(0.001)
    assert next(number) == 1, "the state was asked for once, and could not be made"
    assert (await anext(shown.frames())).plain.endswith(b"good\n\n")
    await hung
    shown.end()


def test_packed_frames_go_into_any_stream() -> None:
    frames = [state_stream.EventFrame.of(number, b"x" * 100 * number) for number in range(1, 6)]
    for chosen in (frames, frames[::2], frames[3:]):
        unpacker = zlib.decompressobj(31)
        assert unpacker.decompress(state_stream.GZIP_HEADER) == b""
        for frame in chosen:  # each is whole as soon as it has come
            assert unpacker.decompress(frame.packed) == frame.plain


@in_loop
async def test_a_browser_that_takes_nothing_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state_stream, "STUCK_SECONDS", 0.05)

    shown = Broadcast(States(), 0.001)

    async def receive() -> Message:
        await asyncio.Event().wait()
        raise AssertionError

    async def send(message: Message) -> None:
        if message["type"] == "http.response.body":
            await asyncio.Event().wait()

    await state_stream.EventStream(shown, packed=False)(SCOPE, receive, send)
    while shown.watchers:
        await asyncio.sleep(0.001)


@in_loop
async def test_a_browser_that_is_gone_is_let_go() -> None:
    shown = Broadcast(States(), 0.001)
    sent: list[bytes] = []
    enough = asyncio.Event()

    async def receive() -> Message:
        await enough.wait()
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        sent.append(message.get("body", b""))
        if len(sent) > 5:
            enough.set()

    await state_stream.EventStream(shown, packed=True)(SCOPE, receive, send)
    while shown.watchers:
        await asyncio.sleep(0.001)
    assert zlib.decompressobj(31).decompress(b"".join(sent)).startswith(b"id: 1\ndata: 1\n\n")


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
        answers = [opened(leaver, port), *(opened(stack, port) for _ in range(state_stream.MAX_BROWSERS - 1))]
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
            serve(live_site(feed, FakeLibrary()), HERE, port, "", Stop(), print)


def view(**more: int) -> JobView:
    (made,) = sample_jobs.views(sample_jobs.values(**more))
    return made


def test_of_many_workers_those_in_trouble_are_listed_and_all_are_counted() -> None:
    many = view(workers=state_stream.MOST_WORKERS + 100)
    workers = [*many.workers[:-1], msgspec.structs.replace(many.workers[-1], state="stuck")]
    team = JobState.of(msgspec.structs.replace(many, workers=workers)).team
    assert team.total == sum(team.states.values()) == state_stream.MOST_WORKERS + 100
    assert len(team.workers) == state_stream.MOST_WORKERS
    assert team.workers[0].state == "stuck"


def test_of_few_workers_the_order_stays() -> None:
    assert JobState.of(view(workers=9)).team.workers == view(workers=9).workers


def test_of_many_runs_the_latest_are_told() -> None:
    keys = Keys("mugs")
    names = [f"run{number}" for number in range(state_stream.MOST_RUNS + 5)]
    runs = {keys.stat(f"run/{name}"): job_status.to_json(sample_jobs.run(name)) for name in names}
    (many,) = sample_jobs.views(sample_jobs.values() | runs)
    state = JobState.of(many)
    assert len(state.runs) == len(state.lefts) == len(state.speeds) == state_stream.MOST_RUNS


def test_what_is_told_are_the_figures_of_the_coordinator(feed: FakeFeed) -> None:
    told = msgspec.json.decode(PageState(feed).state())["jobs"][1]
    (job,) = [job for job in feed.views() if job.job == "mug"]
    assert told["figures"] == msgspec.to_builtins(job.figures)
    assert told["runs"] == msgspec.to_builtins(job.runs)
    assert told["left"] == job.figures.left
