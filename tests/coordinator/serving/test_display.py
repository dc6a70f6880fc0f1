"""What late comers are told of a job."""

import pytest

from qdgrasp_coordinator.counts.curve import Curve, Point
from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.serving.display import DRAWN, PATIENCE, Display
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import NoReply

ROOT = "qdgrasp/v1/mugs/stat"


class Wall:
    """A display with a clock that is set by hand, and the curve of one run."""

    def __init__(self) -> None:
        self.now = 100.0
        self.points: list[Point] = []
        self.display = Display(self.curves, lambda: self.now)

    def curves(self) -> dict[str, Curve]:
        return {f"{ROOT}/curve/a": Curve(run="a", points=self.points)}

    def asked(self, key: str) -> dict[str, bytes]:
        return self.display.values(Query(f"{ROOT}/{key}", "", b""))


def test_what_was_shown_last_is_told_by_its_key() -> None:
    wall = Wall()
    for payload in (b"1", b"2"):
        wall.display.fill(f"{ROOT}/job", payload)
    wall.display.fill(f"{ROOT}/run/a", b"3")
    assert wall.asked("**") == {f"{ROOT}/job": b"2", f"{ROOT}/run/a": b"3"}
    assert wall.asked("run/*") == {f"{ROOT}/run/a": b"3"}


def test_what_is_not_there_any_more_is_told_to_nobody() -> None:
    wall = Wall()
    for key in ("job", "run/a", "run/b", "team/0", "team/1"):
        wall.display.fill(f"{ROOT}/{key}", b"")
    wall.display.keep(f"{ROOT}/run/*", {"b"})
    wall.display.keep(f"{ROOT}/team/*", {"0"})
    assert {*wall.asked("**")} == {f"{ROOT}/{key}" for key in ("job", "run/b", "team/0")}


def test_curves_are_drawn_once_in_a_while_however_many_ask() -> None:
    wall = Wall()
    before = wall.asked("curve/*")
    wall.points = [Point(1, 1, 1, 1, 1)]
    assert wall.asked("curve/a") == before
    wall.now += DRAWN
    assert wall.asked("curve/a") == {f"{ROOT}/curve/a": to_json(Curve(run="a", points=wall.points))}


def test_of_a_coordinator_that_stands_still_nothing_is_told() -> None:
    wall = Wall()
    wall.display.fill(f"{ROOT}/job", b"")
    wall.now += PATIENCE
    assert wall.asked("job")
    wall.now += 0.1
    with pytest.raises(NoReply):
        wall.asked("job")
