"""What monitors cost a coordinator: what it sends and keeps does not depend on how many there are."""

import gc
import time
import tracemalloc
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager

from tests.coordinator.recording.recorded import JOB
from tests.coordinator.serving.served import PLANS, SHAPE, Runs, until

from qdgrasp_coordinator.monitor.feed import NEWS, Feed
from qdgrasp_coordinator.serving.board import Board
from qdgrasp_coordinator.serving.inbox import JoinRequest
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.lanes import Lanes
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.local_bus import LocalBus, LocalNetwork
from qdgrasp_protocol.messages import Join

WORKERS = 70
"""More than stand on one page."""
OWN = tracemalloc.Filter(True, "*/qdgrasp_coordinator/serving/*")


class Counted(LocalBus):
    """A session that notes what is put."""

    def __init__(self, network: LocalNetwork) -> None:
        super().__init__(network)
        self.keys: list[str] = []
        self.channels: set[Channel] = set()

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        self.keys.append(key)
        self.channels.add(channel)
        super().put(key, payload, encoding=encoding, channel=channel)


class Coordinator:
    """What a coordinator shows of three runs and many workers; somebody else says when."""

    def __init__(self, network: LocalNetwork) -> None:
        self.bus = Counted(network)
        self.now = 1.0 + int(time.monotonic())  # its runs were opened before that
        programme = Runs(dict(PLANS))
        lanes = Lanes(programme, lambda run: Memory(SHAPE), lambda _news: None, Stop())
        for _ in range(3):
            assignment = programme.next()
            assert assignment is not None
            lane = Lane(assignment, Memory(SHAPE))
            lane.open(1, lambda: None)
            lanes.begin(lane)
        self.turn = Turn(JOB, 1, lanes, lambda *_message: None, None)
        for number in range(WORKERS):
            self._join(f"{number:032x}")
        self.board = Board(self.bus, JOB, lanes, lambda: self.turn, lambda: self.now)

    def _join(self, wid: str) -> None:
        join = Join(versions=[1], wid=wid, number=1, credit=2, held=[], host="h", pid=1, platform={"a": "1"})
        self.turn.take(JoinRequest(join, Future()), self.now)

    @contextmanager
    def open(self) -> Iterator[None]:
        keys = Keys(JOB)
        self.board.open(self.now)
        with ExitStack() as stack:
            for shown in (keys.stat(), keys.meta, keys.recent):
                stack.enter_context(self.bus.show(shown, self.board.display.values))
            stack.enter_context(self.bus.token(keys.coordinator_token(1)))
            yield

    def show(self) -> None:
        """Show for twenty seconds how far it is, and that things happen."""
        for quarter in range(80):
            self.board.publish_due(self.now + quarter / 4)
            if quarter % 20 == 0:
                self.board.chronicle.note("worker", "A worker has joined.")


@contextmanager
def watching(network: LocalNetwork, monitors: int) -> Iterator[None]:
    """So many monitors that read, and as many that are stopped: nobody takes what is in their rings."""
    with ExitStack() as stack:
        for _ in range(monitors):
            stopped = network.session()
            for what, capacity in NEWS.items():
                stack.enter_context(stopped.ring(f"{Keys(JOB).root}/{what}", capacity))
            feed = stack.enter_context(Feed(network.session()))
            until(lambda feed=feed: any(len(view.workers) == WORKERS for view in feed.views()))
        yield


def sent(monitors: int) -> list[str]:
    network = LocalNetwork()
    coordinator = Coordinator(network)
    with coordinator.open(), watching(network, monitors):
        coordinator.show()
    return coordinator.bus.keys


def kept(monitors: int) -> int:
    """The memory that the coordinator's own modules hold after that [bytes]."""
    network = LocalNetwork()
    tracemalloc.start()
    try:
        coordinator = Coordinator(network)
        with coordinator.open(), watching(network, monitors):
            coordinator.show()
            gc.collect()
            found = tracemalloc.take_snapshot().filter_traces([OWN]).statistics("filename")
    finally:
        tracemalloc.stop()
    return sum(each.size for each in found)


def test_a_coordinator_sends_the_same_to_nobody_and_to_twenty() -> None:
    alone = sent(0)
    assert len(alone) > 200
    assert sent(10) == alone


def test_what_a_coordinator_keeps_does_not_grow_with_those_who_watch() -> None:
    kept(1)  # what is remembered of the first time
    assert kept(10) <= kept(0) + 4096


def test_all_that_is_shown_is_dropped_before_anybody_waits() -> None:
    coordinator = Coordinator(LocalNetwork())
    with coordinator.open():
        coordinator.board.publish_meta("mine")
        coordinator.show()
    assert coordinator.bus.channels == {Channel.MONITOR}
