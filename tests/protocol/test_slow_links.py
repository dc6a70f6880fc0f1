"""Sessions over long links: opened with patience, opened again after a cut, and told apart from silence."""

import socket
import threading
from pathlib import Path
from queue import SimpleQueue

import pytest
from tests.common import HOST, PATIENCE, free_port, own_endpoint
from tests.fakes.slow_link import slow_link

from qdgrasp_protocol.errors import EndpointError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import Credentials, Endpoint, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.security import SecurityFolder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return SecurityFolder.create(tmp_path_factory.mktemp("s") / "security", hosts=[HOST], days=1).path


def test_a_session_is_opened_and_opened_again_over_a_long_link(folder: Path) -> None:
    near, shown = own_endpoint("tls"), {role: Credentials.find(folder, role) for role in Role}
    links, heard = SimpleQueue[bool](), SimpleQueue[bytes]()
    with (
        ZenohBus.router(near, credentials=shown[Role.ROUTER]) as router,
        slow_link(Endpoint.parse(near).port, 0.6, 0.05) as link,
        ZenohBus.connect(f"tls/{HOST}:{link.port}", 30.0, credentials=shown[Role.WORKER]) as bus,
        bus.on_link(links.put),
        router.subscribe("qdgrasp/v1/mugs/@result/*", lambda sample: heard.put(sample.payload)),
    ):
        link.cut()
        assert links.get(timeout=PATIENCE) is False
        assert links.get(timeout=PATIENCE) is True
        while heard.empty():  # the router may tell of its subscriber later
            bus.put("qdgrasp/v1/mugs/@result/a", b"here", encoding="text/plain")
        assert heard.get() == b"here"


def test_a_router_that_never_answers_holds_up_another_one_for_seconds_only() -> None:
    far = own_endpoint()
    with (
        socket.create_server((HOST, 0)) as mute,
        ZenohBus.router(far),
        ZenohBus.connect(f"tcp/{HOST}:{mute.getsockname()[1]},{far}", 30.0),
    ):
        pass


def test_a_signal_is_heard_while_a_router_does_not_answer() -> None:
    stop = Stop()
    with socket.create_server((HOST, 0)) as mute:

        def ask_to_stop() -> None:
            mute.accept()[0].recv(1)
            stop.set(15)

        threading.Thread(target=ask_to_stop, daemon=True).start()
        with pytest.raises(SystemExit) as caught:
            ZenohBus.connect(f"tcp/{HOST}:{mute.getsockname()[1]}", 3600.0, stop)
    assert caught.value.code == 143


def test_silence_of_a_port_is_told_apart_from_a_port_that_nothing_listens_on() -> None:
    with socket.create_server((HOST, 0)) as mute:
        closed, open_ = free_port(), mute.getsockname()[1]
        with pytest.raises(EndpointError) as caught:
            ZenohBus.connect(f"tcp/{HOST}:{closed},tcp/{HOST}:{open_}", 0.3)
    assert f"tcp/{HOST}:{closed}: connection refused; tcp/{HOST}:{open_}: something listens" in str(
        caught.value
    )
