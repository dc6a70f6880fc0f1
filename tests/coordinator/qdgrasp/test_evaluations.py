"""Genomes, poses and places of a program are checked before anything is started."""

import multiprocessing
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.common import PATIENCE
from tests.tools.monitor.sample_jobs import figures

import qdgrasp
from qdgrasp.arguments import check_genomes
from qdgrasp.backend import ROUTER_SECONDS, SilentProgress
from qdgrasp_protocol.errors import EndpointError, ImpossibleValue, InputError, SecurityError
from qdgrasp_protocol.rows import Gene, Layout
from qdgrasp_protocol.session import Role
from qdgrasp_tools.security import SecurityFolder

TWO = Layout("contact", (Gene("nu", 0.0, 1.0), Gene("d", 0.0, 0.1)))
POSE = Layout("given", (Gene("x", -1.0, 1.0), Gene("y", -1.0, 1.0)))


def test_genomes_become_single_floats_of_their_own() -> None:
    given = np.array([[1, -1], [0, 1]], order="F")
    genomes = check_genomes(given, TWO)
    assert genomes.dtype == np.float32
    assert genomes.flags.c_contiguous
    assert genomes.tolist() == given.tolist()
    genomes[:] = 0
    assert given.any()


@pytest.mark.parametrize(
    ("given", "layout", "why"),
    [
        *(
            (other, TWO, r"shape \(n, 2\): nu, d, got \(")
            for other in ([0.0, 0.0], [[0.0]], np.zeros((2, 3)))
        ),
        ([[0.0, 1.5], [0.0, 0.0]], TWO, r"in \[-1, 1\] \(1 numbers are not\), got 1.5"),
        ([[0.0, np.nan]], POSE, "finite"),
    ],
)
def test_genomes_of_another_shape_or_outside_their_intervals_are_refused(given, layout, why) -> None:
    with pytest.raises(ImpossibleValue, match=why):
        check_genomes(given, layout)


ABOVE, DOWN = [[0.0, 0.0, 0.15]], [[1.0, 0.0, 0.0, 0.0]]
BAD = {
    "a ragged list": ({"positions": [[0, 0, 1], [1]]}, "positions must be numbers of shape"),
    "no pose": ({"positions": [[]] * 0}, "positions must be numbers of shape"),
    "another keyword": ({"colour": 3}, "Unknown keyword 'colour'"),
    "no object": ({"object": None}, "'object' is missing; say object=... with a name or a file"),
    "nobody who evaluates": ({"place": qdgrasp.Place(workers=0)}, "has no workers"),
}


@pytest.mark.parametrize(("changed", "why"), BAD.values(), ids=BAD)
def test_what_cannot_be_scored_is_refused(changed: dict[str, Any], why: str) -> None:
    asked = {"positions": ABOVE, "quaternions_xyzw": DOWN, "gripper": "panda", "object": "mug"} | changed
    with pytest.raises(InputError, match=why):
        qdgrasp.evaluate(**asked)


LOCAL = ["127.0.0.1"]
ENCRYPTED = "tls/127.0.0.1:7447"


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"workers": -3}, "Place: workers must be a whole number, at least 0, got -3"),
        ({"batch_size": 0}, "Place: batch_size must be a whole number, at least 1, got 0"),
        ({"job": "Not so"}, "1 to 64 of the characters"),
        ({"connect": "here"}, "'here' is not an endpoint"),
    ],
)
def test_what_is_no_place_is_refused(said: dict[str, Any], why: str) -> None:
    with pytest.raises(qdgrasp.InputError, match=why):
        qdgrasp.Place(**said)


def test_that_nobody_comes_is_said_once_and_not_at_first() -> None:
    quiet = SilentProgress()
    said: list[str] = []
    quiet.say = said.append  # type: ignore[method-assign]  # what it says is heard
    quiet.show(figures(seconds=1.0, workers=0, rate=0.0))
    for times, workers in ((2, 2), (3, 0), (4, 0)):
        quiet.show(figures(seconds=times * ROUTER_SECONDS, workers=workers, rate=0.0))
    assert said == ["job 'mugs' waits: no worker has come to it yet"]


def test_an_encrypted_router_needs_the_certificates_of_a_coordinator(tmp_path: Path) -> None:
    with pytest.raises(EndpointError, match="needs certificates"):
        qdgrasp.Place(connect=ENCRYPTED).meet()
    lab = SecurityFolder.create(tmp_path / "lab", hosts=LOCAL, days=1)
    worker = lab.add(Role.WORKER, "node", hosts=LOCAL, days=1)
    with pytest.raises(SecurityError, match=r"lacks coordinator.pem and coordinator.key"):
        qdgrasp.Place(connect=ENCRYPTED, security=worker).meet()


def meet_and_say(said: Connection) -> None:
    """Use the bus, and say what came of it."""
    try:
        qdgrasp.Place().meet()
    except InputError as error:
        said.send(str(error))


def test_a_process_forked_after_the_bus_was_used_says_so_and_waits_for_nothing() -> None:
    qdgrasp.Place().meet()[0].close()
    context = multiprocessing.get_context("fork")
    heard, said = context.Pipe(duplex=False)
    child = context.Process(target=meet_and_say, args=(said,))
    child.start()
    try:
        assert heard.poll(PATIENCE)
        assert "start processes by spawn" in heard.recv()
    finally:
        child.kill()
        child.join()
