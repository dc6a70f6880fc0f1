from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.common import own_endpoint

from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.security.folder import SecurityFolder

HOSTS = ("localhost", "127.0.0.1")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that `qdgrasp security init` wrote."""
    return SecurityFolder.create(tmp_path_factory.mktemp("home") / "security", hosts=HOSTS, days=2).path


def encrypted_endpoint() -> str:
    """One on a port that is free now."""
    return own_endpoint("tls")


@pytest.fixture(scope="session")
def secured(folder: Path) -> Iterator[str]:
    """The endpoint of a router with the access list."""
    endpoint = encrypted_endpoint()
    with ZenohBus.router(endpoint, credentials=Credentials.find(folder, Role.ROUTER)):
        yield endpoint
