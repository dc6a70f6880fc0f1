"""Places that cannot be: refused before anything is started."""

from pathlib import Path
from typing import Any

import pytest
from tests.coordinator.monitor.shown import figures

import qdgrasp
from qdgrasp.places import PATIENCE, Quiet
from qdgrasp_coordinator.security.folder import SecurityFolder
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.errors import EndpointError, SecurityError

LOCAL = ["127.0.0.1"]
ENCRYPTED = "tls/127.0.0.1:7447"


def test_a_place_of_all_cores_has_as_many_workers_and_one_at_a_router_none() -> None:
    assert qdgrasp.Place().hands >= 1
    assert qdgrasp.Place(connect=ENCRYPTED).hands == 0
    assert qdgrasp.Place(connect=ENCRYPTED, workers=3).hands == 3


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"workers": -3}, "Place: workers must be a whole number, at least 0, got -3"),
        ({"workers": True}, "workers must be a whole number"),
        ({"workers": "two"}, "workers must be a whole number"),
        ({"batch_size": 0}, "Place: batch_size must be a whole number, from 1 to 4096, got 0"),
        ({"batch_size": 5000}, "from 1 to 4096"),
        ({"job": 3}, "Place: job must be text, got 3"),
        ({"job": "Not so"}, "1 to 64 of the characters"),
        ({"connect": 7447}, "Place: connect must be text"),
        ({"connect": ""}, "Place: connect must be text"),
        ({"connect": "here"}, "'here' is not an endpoint"),
        ({"connect": ENCRYPTED, "security": 3}, "Place: security must be a path, got 3"),
    ],
)
def test_what_is_no_place_is_refused(said: dict[str, Any], why: str) -> None:
    with pytest.raises(qdgrasp.InputError, match=why):
        qdgrasp.Place(**said)


def test_what_is_no_place_at_all_is_refused(tmp_path: Path) -> None:
    words: dict[str, Any] = {"gripper": "panda", "object": "tennis_ball", "place": "here"}
    with pytest.raises(qdgrasp.InputError, match=r"place must be a qdgrasp\.Place"):
        qdgrasp.Evaluations(**words)
    with pytest.raises(qdgrasp.InputError, match=r"place must be a qdgrasp\.Place"):
        qdgrasp.optimise(print, tmp_path / "run", evaluations=9, **words)  # type: ignore[arg-type]  # not looked at


def test_that_nobody_comes_is_said_once_and_not_at_first() -> None:
    quiet = Quiet()
    said: list[str] = []
    quiet.say = said.append  # type: ignore[method-assign]  # what it says is heard
    for seconds, workers in ((1.0, 0), (2 * PATIENCE, 2), (3 * PATIENCE, 0), (4 * PATIENCE, 0)):
        quiet.show(figures(seconds=seconds, workers=workers, rate=0.0))
    assert said == ["job 'mugs' waits: no worker has come to it yet"]


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
