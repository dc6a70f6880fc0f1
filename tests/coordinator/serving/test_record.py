"""What a coordinator does with what a recorder answers."""

import pytest
from tests.coordinator.runs.plans import SHAPE

from qdgrasp_coordinator.serving.recorder_link import RecorderLink
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import InputError, NoReply, Refused, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.local_bus import LocalBus, LocalNetwork
from qdgrasp_protocol.messages import OpenRun

RUN = OpenRun(run="one", spec=b"", scene="0" * 64, genes=4, joints=1, descriptors=3)


def refuse(_query: Query) -> bytes:
    raise Refused("rows 7 to 9 are not what was recorded")


def wait() -> None:
    raise AssertionError("the recorder answered")


def test_a_recorder_that_refuses_is_quoted() -> None:
    network, keys = LocalNetwork(), Keys("many")
    link = RecorderLink(network.session(), "many", SHAPE)
    with network.session().answer(keys.open, refuse), pytest.raises(InputError, match="rows 7 to 9"):
        link.open(RUN, 0, wait)
    with network.session().answer(keys.log, refuse), pytest.raises(InputError, match="rows 7 to 9"):
        link.recorded(0, wait)


def test_a_recorder_that_serves_another_coordinator_ends_this_one() -> None:
    def replaced(_query: Query) -> bytes:
        raise TookOver.refusal(1, 2)

    network = LocalNetwork()
    link = RecorderLink(network.session(), "many", SHAPE)
    with (
        network.session().answer(Keys("many").open, replaced),
        pytest.raises(TookOver, match=r"^Another coordinator of job 'many' took over \(epoch 2\)\.$"),
    ):
        link.open(RUN, 1, wait)


class Deaf(LocalBus):
    """A session whose questions are lost, or find nobody; it keeps how long each might have waited."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, is_lost: bool) -> None:
        super().__init__(LocalNetwork())
        self.waited: list[float] = []
        self._now = 0.0
        self._is_lost = is_lost
        monkeypatch.setattr("time.monotonic", lambda: self._now)

    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        self.waited.append(timeout)
        self._now += timeout if self._is_lost else 0.0
        raise NoReply("nothing came")


@pytest.mark.parametrize(
    ("is_lost", "waited"), [(True, [1.0, 2.0, 4.0, 8.0, 10.0, 10.0]), (False, [1.0] * 6)]
)
def test_a_question_that_was_lost_is_soon_asked_again_and_a_slow_recorder_has_time(
    monkeypatch: pytest.MonkeyPatch, is_lost: bool, waited: list[float]
) -> None:
    class Enough(Exception):
        """The test has seen enough."""

    def look() -> None:
        if len(bus.waited) == len(waited):
            raise Enough

    bus = Deaf(monkeypatch, is_lost=is_lost)
    with pytest.raises(Enough):
        RecorderLink(bus, "many", SHAPE).open(RUN, 0, look)
    assert bus.waited == waited
