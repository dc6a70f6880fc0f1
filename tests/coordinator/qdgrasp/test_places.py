"""Places that cannot be: refused before anything is started."""

from pathlib import Path

import pytest

import qdgrasp
from qdgrasp_coordinator.security.folder import SecurityFolder
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.errors import EndpointError, SecurityError

LOCAL = ["127.0.0.1"]
ENCRYPTED = "tls/127.0.0.1:7447"


def test_a_place_of_all_cores_has_as_many_workers_and_one_at_a_router_none() -> None:
    assert qdgrasp.Place().hands >= 1
    assert qdgrasp.Place(connect=ENCRYPTED).hands == 0
    assert qdgrasp.Place(connect=ENCRYPTED, workers=3).hands == 3


def test_certificates_without_a_router_are_refused(tmp_path: Path) -> None:
    with pytest.raises(qdgrasp.InputError, match="name it with connect="):
        qdgrasp.Place(security=tmp_path)


def test_an_encrypted_router_needs_the_certificates_of_a_coordinator(tmp_path: Path) -> None:
    with pytest.raises(EndpointError, match="needs certificates"):
        qdgrasp.Place(connect=ENCRYPTED).meet()
    lab = SecurityFolder.create(tmp_path / "lab", hosts=LOCAL, days=1)
    worker = lab.add(Role.WORKER, "node", hosts=LOCAL, days=1)
    with pytest.raises(SecurityError, match=r"lacks coordinator.pem and coordinator.key"):
        qdgrasp.Place(connect=ENCRYPTED, security=worker).meet()
