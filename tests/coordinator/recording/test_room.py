from math import inf
from pathlib import Path

import pytest

from qdgrasp_coordinator.recording.room import RETRY_INTERVAL, Room
from qdgrasp_protocol.errors import DiskFull


def test_a_full_disk_is_tried_again_and_given_up_after_the_patience() -> None:
    room = Room(Path("runs/mugs"), patience=10.0)
    for now in (100.0, 105.0, 110.0):
        room.missed("no room", now, "qdgrasp resume runs/mugs")
        assert (room.trouble, room.try_at) == ("no room", now + RETRY_INTERVAL)
    with pytest.raises(DiskFull, match=r"runs/mugs has had no room for 10 s.*`qdgrasp resume runs/mugs`"):
        room.missed("no room", 110.1, "qdgrasp resume runs/mugs")


def test_room_that_was_found_begins_the_patience_anew() -> None:
    room = Room(Path("runs/mugs"), patience=10.0)
    room.missed("no room", 100.0, "")
    room.found()
    assert (room.trouble, room.try_at) == ("", -inf)
    room.missed("no room", 200.0, "")
