"""What tests of all rooms share: patience, endpoints of their own, and changed scenes."""

import socket
from typing import Any

from msgspec.structs import replace

from qdgrasp_assets.scene import Scene

PATIENCE = 120.0
"""Seconds; whoever waits is told at once when it happens, and a test that waits in vain fails after that."""


def own_endpoint() -> str:
    """One on a port that is free now, and never the default one: runs in other tests listen there."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def with_gripper(scene: Scene, **changes: Any) -> Scene:
    """A scene whose gripper has other values."""
    return replace(scene, gripper=replace(scene.gripper, **changes))
