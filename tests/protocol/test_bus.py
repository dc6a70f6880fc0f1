"""The contract of every bus, one class of tests over all; and bundles sent over one."""

import hashlib
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import pytest
from structlog.testing import capture_logs
from tests.common import PATIENCE, free_port, own_endpoint
from tests.fakes.memory_bus import MemoryNetwork

from qdgrasp_protocol import messages, session
from qdgrasp_protocol.bus import (
    CHUNK_SIZE,
    Bus,
    Channel,
    Query,
    RingBuffer,
    Sample,
    answer_chunk,
    fetch_bundle,
)
from qdgrasp_protocol.errors import BusError, EndpointError, Faulty, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Chunk
from qdgrasp_protocol.zenoh_bus import ZenohBus, free_endpoint

TEXT = "text/plain"
QUIET = 0.2  # seconds in which nothing is to happen

Opener = Callable[[], Bus]


@pytest.fixture(params=["local", "zenoh"])
def opener(request: pytest.FixtureRequest) -> Iterator[Opener]:
    """Opens sessions of one network, which are closed at the end."""
    with ExitStack() as stack:
        if request.param == "local":
            network = MemoryNetwork()
            yield lambda: stack.enter_context(network.session())
        else:
            endpoint = own_endpoint()
            stack.enter_context(ZenohBus.router(endpoint))
            yield lambda: stack.enter_context(ZenohBus.connect(endpoint, PATIENCE))


@pytest.fixture
def near(opener: Opener) -> Bus:
    return opener()


@pytest.fixture
def far(opener: Opener) -> Bus:
    return opener()


class Ear:
    """A handler that keeps the values that it is called with."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Any] = SimpleQueue()

    def __call__(self, *heard: Any) -> None:
        self._queue.put(heard[0] if len(heard) == 1 else heard)

    def next(self, timeout: float = PATIENCE) -> Any:
        return self._queue.get(timeout=timeout)

    def hears_nothing(self) -> bool:
        try:
            self._queue.get(timeout=QUIET)
        except Empty:
            return True
        return False


def connected(near: Bus, far: Bus) -> None:
    """Wait until `near` knows what `far` declared; declarations of a session keep their order."""
    ear = Ear()
    with near.watch("test/here", ear), far.token("test/here"):
        assert ear.next() == ("test/here", True)


class TestBus:
    def test_a_message_arrives_byte_for_byte_with_its_key_and_encoding(self, near: Bus, far: Bus) -> None:
        ear, payload = Ear(), bytes(range(256)) * 5000
        with far.subscribe("test/a", ear):
            connected(near, far)
            for channel in Channel:
                near.put("test/a", payload, encoding="application/msgpack;qdgrasp.work.v1", channel=channel)
                assert ear.next() == Sample("test/a", payload, "application/msgpack;qdgrasp.work.v1")

    def test_a_star_is_one_chunk_and_verbatim_chunks_match_only_themselves(self, near: Bus, far: Bus) -> None:
        one, any_, verbatim = Ear(), Ear(), Ear()
        with ExitStack() as stack:
            stack.enter_context(far.subscribe("test/*", one))
            stack.enter_context(far.subscribe("test/**", any_))
            stack.enter_context(far.subscribe("test/@work/*", verbatim))
            connected(near, far)
            for key in ("test/@work/w", "test/@x", "test/a/b", "test/a"):
                near.put(key, b"", encoding=TEXT)
            assert verbatim.next().key == "test/@work/w"
            assert one.next().key == "test/a"
            assert [any_.next().key, any_.next().key] == ["test/a/b", "test/a"]

    def test_many_messages_arrive_in_order(self, near: Bus, far: Bus) -> None:
        ear, many = Ear(), 3000
        with far.subscribe("test/a", ear):
            connected(near, far)
            for number in range(many):
                near.put("test/a", number.to_bytes(4, "little"), encoding=TEXT)
            heard = [int.from_bytes(ear.next().payload, "little") for _ in range(many)]
        assert heard == list(range(many))

    def test_who_unsubscribed_hears_nothing_more(self, near: Bus, far: Bus) -> None:
        gone, still = Ear(), Ear()
        with far.subscribe("test/a", still):
            with far.subscribe("test/a", gone):
                connected(near, far)
            near.put("test/a", b"1", encoding=TEXT)
            assert still.next().payload == b"1"
            assert gone.hears_nothing()

    def test_a_handler_that_raises_is_logged_and_hears_the_next_message(self, near: Bus) -> None:
        ear = Ear()

        def handler(sample: Sample) -> None:
            ear(sample.payload)
            raise ValueError("on purpose")

        with capture_logs() as logs, near.subscribe("test/a", handler):
            near.put("test/a", b"1", encoding=TEXT)
            near.put("test/a", b"2", encoding=TEXT)
            assert [ear.next(), ear.next()] == [b"1", b"2"]
        assert logs[0]["event"] == "a callback failed"

    def test_a_ring_takes_messages_in_their_order(self, near: Bus, far: Bus) -> None:
        heard: list[int] = []
        with far.ring("test/a", 16) as ring:
            connected(near, far)
            for number in range(10):
                near.put("test/a", bytes([number]), encoding=TEXT)
            while len(heard) < 10:
                heard += [sample.payload[0] for sample in ring.take()]
            assert (heard, ring.take()) == ([*range(10)], [])

    def test_a_query_is_answered_with_what_its_handler_returns(self, near: Bus, far: Bus) -> None:
        def answer(query: Query) -> bytes:
            return f"{query.key} {query.parameters} ".encode() + query.payload

        with far.answer("test/@asset/*", answer):
            connected(near, far)
            assert (
                near.ask("test/@asset/x", b"\x00\xff", parameters="i=3", timeout=PATIENCE)
                == b"test/@asset/x i=3 \x00\xff"
            )
            assert near.ask("test/@asset/y", timeout=PATIENCE) == b"test/@asset/y  "

    @pytest.mark.parametrize(
        ("raised", "kind", "words"),
        [
            (Refused("no such scene: größer"), Refused, "no such scene: größer"),
            (NoReply("busy"), NoReply, None),  # a query may be left without a reply
            (ZeroDivisionError(), Faulty, "ZeroDivisionError"),
        ],
    )
    def test_a_refusal_has_its_reason_and_a_failure_is_logged(self, near, far, raised, kind, words) -> None:
        def answer(query: Query) -> bytes:
            raise raised

        with far.answer("test/q", answer), capture_logs() as logs:
            connected(near, far)
            with pytest.raises(kind, match=words):
                near.ask("test/q", timeout=PATIENCE)
        assert ("test/q" in [line.get("key") for line in logs]) == (kind is Faulty)

    def test_asking_where_nobody_answers_gets_no_reply(self, near: Bus, far: Bus) -> None:
        with pytest.raises(NoReply, match="test/nobody"):
            near.ask("test/nobody", timeout=PATIENCE)
        with far.answer("test/q", lambda query: b""):
            connected(near, far)
            near.ask("test/q", timeout=PATIENCE)
        connected(near, far)
        with pytest.raises(NoReply):
            near.ask("test/q", timeout=PATIENCE)

    def test_values_are_found_by_their_keys_and_by_patterns(self, near: Bus, far: Bus) -> None:
        values = {"test/a/stat/job": b"1", "test/a/stat/run/x": b"2", "test/a/stat/run/y": b"3"}
        with (
            far.answer_values("test/a/stat/**", lambda _: values),
            far.answer_values("test/b/stat/**", lambda _: {"test/b/stat/job": b"4"}),
        ):
            connected(near, far)
            assert near.ask("test/a/stat/job", timeout=PATIENCE) == b"1"
            assert near.ask_all("test/a/stat/run/*") == {key: values[key] for key in list(values)[1:]}
            assert near.ask_all("test/*/stat/job") == {"test/a/stat/job": b"1", "test/b/stat/job": b"4"}
            assert near.ask_all("test/*/nothing") == {}
            with pytest.raises(NoReply):
                near.ask("test/a/stat/nothing", timeout=PATIENCE)

    def test_an_answer_that_comes_too_late_is_no_reply(self, near: Bus, far: Bus) -> None:
        asked_enough = threading.Event()

        def slow(query: Query) -> bytes:
            asked_enough.wait(PATIENCE)
            return b"late"

        with far.answer("test/q", slow):
            connected(near, far)
            with pytest.raises(NoReply, match="test/q"):
                near.ask("test/q", timeout=0.1)
            asked_enough.set()

    def test_tokens_declared_before_and_after_the_watch_are_seen_and_so_is_their_end(self, near, far) -> None:
        ear = Ear()
        with far.token("test/live/early"):
            connected(near, far)
            with near.watch("test/live/*", ear):
                assert ear.next() == ("test/live/early", True)
                with far.token("test/live/late"):
                    assert ear.next() == ("test/live/late", True)
                assert ear.next() == ("test/live/late", False)
        assert ear.hears_nothing()

    def test_a_closed_session_has_no_tokens(self, near: Bus, far: Bus) -> None:
        ear = Ear()
        far.token("test/live/far")
        with near.watch("test/live/**", ear):
            assert ear.next() == ("test/live/far", True)
            far.close()
            assert ear.next() == ("test/live/far", False)

    def test_closing_twice_is_allowed_and_a_closed_session_says_that_it_is(self, near: Bus) -> None:
        declared = near.subscribe("test/a", Ear())
        near.close()
        near.close()
        declared.__exit__(None, None, None)
        for act in (
            lambda: near.put("test/a", b"", encoding=TEXT),
            lambda: near.ask("test/a", timeout=PATIENCE),
            lambda: near.token("test/a"),
            lambda: near.subscribe("test/a", Ear()),
        ):
            with pytest.raises(BusError):
                act()


def test_of_more_messages_than_a_ring_holds_the_newest_are_kept() -> None:
    ring, samples = RingBuffer(3), [Sample("test/a", bytes([number]), TEXT) for number in range(10)]
    for sample in samples:
        ring.put(sample)
    assert ring.take() == samples[-3:]


class TestZenohBus:
    def test_tokens_subscribers_and_links_come_back_with_the_router(self) -> None:
        endpoint, links, tokens, heard = own_endpoint(), Ear(), Ear(), Ear()
        with ExitStack() as stack:
            router = stack.enter_context(ZenohBus.router(endpoint))
            client = stack.enter_context(ZenohBus.connect(endpoint, PATIENCE))
            router.token("test/router")
            client.token("test/client")
            client.on_link(links)
            client.watch("test/router", tokens)
            client.subscribe("test/a", heard)
            assert tokens.next() == ("test/router", True)
            router.close()
            assert links.next() is False
            assert tokens.next() == ("test/router", False)
            router = stack.enter_context(ZenohBus.router(endpoint))
            assert links.next() is True
            router.token("test/router")
            assert tokens.next() == ("test/router", True)
            seen = Ear()
            router.watch("test/client", seen)
            assert seen.next() == ("test/client", True)
            router.put("test/a", b"again", encoding=TEXT)
            assert heard.next().payload == b"again"

    def test_a_router_that_is_not_there_is_named_when_the_deadline_is_over(self) -> None:
        with socket.socket() as held:  # so that no other program takes the port; it does not listen
            held.bind(("127.0.0.1", 0))
            endpoint = f"tcp/127.0.0.1:{held.getsockname()[1]}"
            with pytest.raises(EndpointError, match=f"Nothing answers within 0.3 s at {endpoint}"):
                ZenohBus.connect(endpoint, 0.3)

    def test_a_file_with_the_endpoint_is_waited_for(self, tmp_path: Path) -> None:
        endpoint, file = own_endpoint(), tmp_path / "endpoint"
        with ThreadPoolExecutor() as pool:
            opening = pool.submit(ZenohBus.connect, str(file), PATIENCE)
            with ZenohBus.router(endpoint):
                (tmp_path / "new").write_text(f"{endpoint},tcp/10.0.0.1:2\n")
                assert not opening.done()
                (tmp_path / "new").rename(file)
                opening.result(PATIENCE).close()

    def test_a_free_endpoint_is_another_one_while_the_default_is_taken(self, monkeypatch) -> None:
        monkeypatch.setattr(session, "PORT", free_port())
        default = f"tcp/{session.LOOPBACK}:{session.PORT}"
        assert free_endpoint() == default
        with socket.create_server((session.LOOPBACK, session.PORT)):
            assert free_endpoint() != default

    def test_a_process_that_leaves_its_session_ends(self) -> None:
        endpoint = own_endpoint()
        code = (
            "from qdgrasp_protocol.zenoh_bus import ZenohBus\n"
            f"here = {endpoint!r}\n"
            f"with ZenohBus.router(here) as router, ZenohBus.connect(here, {PATIENCE}) as bus:\n"
            "    bus.token('test/a'); bus.subscribe('test/b', print); bus.answer('test/c', print)\n"
            "    router.watch('test/*', print); bus.on_link(print)\n"
            "    raise SystemExit(7)\n"
        )
        done = subprocess.run([sys.executable, "-c", code], timeout=PATIENCE, check=False)
        assert done.returncode == 7


KEYS = Keys("mugs")


def digest(payload: bytes) -> str:
    return hashlib.sha256(payload).hexdigest()


@pytest.mark.parametrize("length", [0, 1, CHUNK_SIZE - 1, CHUNK_SIZE, CHUNK_SIZE + 1, 3 * CHUNK_SIZE])
def test_a_bundle_of_any_length_arrives_whole(length: int) -> None:
    payload = bytes(i % 251 for i in range(length))
    network = MemoryNetwork()
    with network.session() as coordinator, network.session() as worker:
        coordinator.answer(KEYS.asset(), lambda query: answer_chunk(query, payload, digest(payload)))
        assert fetch_bundle(worker, KEYS.asset(digest(payload))) == payload


@pytest.mark.parametrize(
    ("asset", "parameters", "words"),
    [
        *(("a", asked, "is not one of 2") for asked in ("", "i=", "i=2", "i=-1", "i=x", "j=0", "i=²")),
        ("b", "i=0", "no such scene"),
    ],
)
def test_a_chunk_or_scene_that_there_is_not_is_refused(asset: str, parameters: str, words: str) -> None:
    with pytest.raises(Refused, match=words):
        answer_chunk(Query(KEYS.asset(asset), parameters, b""), bytes(CHUNK_SIZE + 1), "a")


def test_what_is_not_the_scene_of_its_digest_is_refused() -> None:
    network = MemoryNetwork()
    with network.session() as bus:
        with pytest.raises(NoReply):
            fetch_bundle(bus, KEYS.asset("a" * 64))
        bus.answer(KEYS.asset(), lambda query: messages.encode(Chunk(total=1, data=b"another")))
        with pytest.raises(MessageError, match="is not aaaaaaaaaaaa"):
            fetch_bundle(bus, KEYS.asset("a" * 64))


def test_a_scene_that_is_said_to_be_too_large_is_not_even_fetched() -> None:
    asked = []

    def answer(query: Query) -> bytes:
        asked.append(query.parameters)
        return messages.encode(Chunk(total=4096, data=b""))

    with MemoryNetwork().session() as bus:
        bus.answer(KEYS.asset(), answer)
        with pytest.raises(MessageError, match="4096 chunks, more than 256"):
            fetch_bundle(bus, KEYS.asset("a" * 64))
    assert asked == ["i=0"]
