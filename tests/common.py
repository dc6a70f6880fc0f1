"""Shared by tests of all rooms: patience, waiting, ports of their own, and changed scenes."""

import fcntl
import os
import secrets
import socket
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, TypeVar

from msgspec.structs import replace

from qdgrasp_assets.scene import Scene

PATIENCE = 120.0
"""Seconds after which a test that waits in vain fails; an event is seen at once."""

Found = TypeVar("Found")


def wait_for(look: Callable[[], Found], what: str = "something", patience: float = PATIENCE) -> Found:
    """Look until something is found, and return it; fail after `patience` seconds."""
    deadline = time.monotonic() + patience
    while not (found := look()):
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.01)  # between two looks; nothing depends on how long it is
    return found


HOST = "127.0.0.1"
PORTS = range(10_000, 32_000)
"""Ports for tests: below those that the kernel gives to connections, and not the default one."""
_LOCKS = Path(tempfile.gettempdir(), f"qdgrasp-test-ports-{os.getuid()}")
_held: list[IO[bytes]] = []


def free_port() -> int:
    """Return a free port that no other test on this machine gets while this process lives.

    A test may stop listening there and listen again, or start a process that listens later.
    """
    _LOCKS.mkdir(exist_ok=True)
    while True:
        port = secrets.choice(PORTS)
        lock = (_LOCKS / str(port)).open("wb")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            socket.create_server((HOST, port)).close()
        except OSError:  # another test has it, or another program listens there
            lock.close()
        else:
            _held.append(lock)
            return port


def own_endpoint(protocol: str = "tcp") -> str:
    """Return an endpoint on a port that no other test gets."""
    return f"{protocol}/{HOST}:{free_port()}"


def with_gripper(scene: Scene, **changes: Any) -> Scene:
    """Return a scene whose gripper has other values."""
    return replace(scene, gripper=replace(scene.gripper, **changes))
