"""Routers: relaying, taking over, and a job over mutual TLS."""

import signal
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from tests.common import PATIENCE, own_endpoint, wait_for
from tests.system.commands import COORDINATOR, RECORDER, ROUTER, WORKER, Commands, end_of, stop

from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.security import SecurityFolder

KEYS = Keys("mugs")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return SecurityFolder.create(tmp_path_factory.mktemp("s") / "security", hosts=["127.0.0.1"], days=1).path


class Routers:
    """Starts routers, each a process that is known to listen."""

    def __init__(self, qdgrasp: Commands, folder: Path) -> None:
        self._qdgrasp = qdgrasp
        self._folder = folder

    def start(self, endpoint: str, *flags: str) -> subprocess.Popen[str]:
        security = ("--security", self._folder) if "tls/" in endpoint else ()
        process = self._qdgrasp.start("--listen", endpoint, *flags, *security, module=ROUTER)
        assert process.stderr is not None
        said = process.stderr.readline()
        assert "listening" in said, said + process.stderr.read()
        assert f"endpoint={endpoint}" in said
        return process


@pytest.fixture
def routers(qdgrasp: Commands, folder: Path) -> Routers:
    return Routers(qdgrasp, folder)


def test_a_router_stops_cleanly_also_with_clients(routers) -> None:
    endpoint = own_endpoint()
    process = routers.start(endpoint)
    with ZenohBus.connect(endpoint, PATIENCE) as client:
        client.token(KEYS.worker_token("w"))
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 128 + signal.SIGTERM


def test_two_routers_relay_and_one_takes_over_from_the_other(routers: Routers, folder: Path) -> None:
    first, second = own_endpoint("tls"), own_endpoint("tls")
    process = routers.start(first)
    routers.start(second, "--connect", first)
    results: SimpleQueue[Any] = SimpleQueue()
    is_alive: list[bool] = []  # As the coordinator is told of the worker's token
    with ExitStack() as stack:

        def session(role: Role, *endpoints: str) -> ZenohBus:
            shown = Credentials.find(folder, role)
            return stack.enter_context(ZenohBus.connect(",".join(endpoints), PATIENCE, credentials=shown))

        coordinator = session(Role.COORDINATOR, second, first)
        worker = session(Role.WORKER, first, second)
        stack.enter_context(coordinator.subscribe(KEYS.result(), results.put))
        stack.enter_context(
            coordinator.watch(KEYS.worker_token("w"), lambda _, alive: is_alive.append(alive))
        )
        stack.enter_context(worker.token(KEYS.worker_token("w")))
        wait_for(lambda: is_alive == [True], "the token")
        arrives(worker, results)
        process.kill()
        arrives(worker, results)
        # A worker that is back before the other router misses the first one was never away
        wait_for(lambda: is_alive in ([True], [True, False, True]), "the token over the other router")
        worker.close()
        wait_for(lambda: not is_alive[-1], "the end of the token")


def arrives(worker: ZenohBus, results: SimpleQueue[Any]) -> None:
    """A result arrives; put while a link is down it is lost, so it is put until one does."""
    deadline = time.monotonic() + PATIENCE
    while results.empty():
        assert time.monotonic() < deadline
        worker.put(KEYS.result("w"), b"result", encoding="text/plain")
        time.sleep(0.01)
    while not results.empty():
        results.get()


MODULES = {"router": ROUTER, "coordinator": COORDINATOR, "recorder": RECORDER, "worker": WORKER}


@pytest.mark.slow
def test_a_run_over_encrypted_links_records_the_same_bytes(qdgrasp, reference) -> None:
    folder, digest, _ = reference
    home = SecurityFolder.create(qdgrasp.home / "security", hosts=["127.0.0.1"], days=1)
    nodes = {name: home.add(Role(name), name, hosts=["127.0.0.1"], days=1) for name in MODULES}
    endpoint = own_endpoint("tls")
    job = ("--job", "run", "--connect", endpoint)
    arguments = {
        "router": ("--listen", endpoint),
        "coordinator": (folder / "spec.toml", *job),
        "recorder": ("--out", "run", *job),
        "worker": job,
    }
    processes = {
        name: qdgrasp.start(*arguments[name], "--security", nodes[name], module=MODULES[name])
        for name in MODULES
    }
    end_of(processes["coordinator"])
    for name in ("worker", "recorder", "router"):
        stop(processes[name], signal.SIGTERM)
    assert qdgrasp.digest("run") == digest
