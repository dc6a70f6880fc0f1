"""What a coordinator does with what a recorder answers."""

import pytest
from tests.coordinator.plans import SHAPE

from qdgrasp_coordinator.record import RecorderLink
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import InputError, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.local_bus import LocalNetwork
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
