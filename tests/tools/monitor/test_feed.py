"""The feed: from the bus into the model of the jobs; and the overview."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from tests.common import PATIENCE
from tests.fakes.memory_bus import MemoryNetwork
from tests.tools.monitor.sample_jobs import figures, run, values

from qdgrasp_coordinator.metrics.job_status import to_json
from qdgrasp_protocol.bus import Bus, Channel, Query
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_model import JobView

MUGS = Keys("mugs")
MUG = RunSpec(gripper="panda", object="mug")


@contextmanager
def coordinator(
    bus: Bus, job: str = "mugs", epoch: int = 2, asked: list[str] | None = None
) -> Iterator[None]:
    """A coordinator that answers queries about its job."""
    keys = Keys(job)
    shown = values(job, epoch=epoch)

    def answer(query: Query) -> dict[str, bytes]:
        if asked is not None:
            asked.append(query.key)
        return shown

    with ExitStack() as stack:
        for pattern in (keys.stat(), keys.meta, keys.recent):
            stack.enter_context(bus.answer_values(pattern, answer))
        stack.enter_context(bus.token(keys.coordinator_token(epoch)))
        yield


def say(bus: Bus, key: str, struct: object) -> None:
    bus.put(key, to_json(struct), encoding="application/json", channel=Channel.MONITOR)  # type: ignore[arg-type]


def until(feed: Feed, holds: Callable[[list[JobView]], bool]) -> list[JobView]:
    """Wait for messages until the views meet a condition."""
    deadline = time.monotonic() + PATIENCE
    while not holds(found := feed.views()):
        assert time.monotonic() < deadline, f"never so: {found}"
        feed.wait(0.05)
    return found


def is_whole(views: list[JobView]) -> bool:
    """Whether all answers of the coordinator have come."""
    return bool(views) and len(views[0].runs) == 2 and len(views[0].workers) == 9


def test_a_feed_hears_what_is_said_and_hears_it_no_more_when_it_is_over(network: MemoryNetwork) -> None:
    with network.session() as bus, coordinator(bus), Feed(network.session()) as feed:
        until(feed, is_whole)
        say(bus, MUGS.stat("job"), figures(evaluations=1234))
        say(bus, MUGS.stat("run/c"), run("c"))
        (view,) = until(feed, lambda views: views[0].figures.evaluations == 1234 and len(views[0].runs) == 3)
        assert view.history.evaluations[-1] == 1234
    say(network.session(), MUGS.stat("job"), figures(evaluations=9999))
    assert feed.views()[0].figures.evaluations == 1234


def test_a_feed_of_one_job_hears_and_asks_nothing_of_others(network: MemoryNetwork) -> None:
    asked: list[str] = []
    with ExitStack() as stack:
        bus = stack.enter_context(network.session())
        stack.enter_context(coordinator(bus, "cubes", asked=asked))
        stack.enter_context(coordinator(bus, "mugs"))
        feed = stack.enter_context(Feed(network.session(), "mugs"))
        until(feed, is_whole)
        say(bus, Keys("cubes").stat("job"), figures(job="cubes"))
        say(bus, MUGS.stat("job"), figures(evaluations=1234))
        until(feed, lambda views: views[0].figures.evaluations == 1234)
        assert [view.job for view in feed.views()] == ["mugs"]
    assert asked == []


def test_a_coordinator_that_goes_and_one_that_comes_are_seen(network: MemoryNetwork) -> None:
    with network.session() as bus, Feed(network.session()) as feed:
        with coordinator(bus, epoch=2):
            until(feed, is_whole)
        until(feed, lambda views: views[0].state == "gone")
        with coordinator(bus, epoch=3):
            (view,) = until(feed, lambda views: views[0].meta.epoch == 3 and views[0].state == "running")
            assert view.silent < PATIENCE


def test_a_feed_survives_that_it_is_cut_off(network: MemoryNetwork) -> None:
    near = network.session()
    with network.session() as bus, Feed(near) as feed, coordinator(bus):
        until(feed, is_whole)
        near.disconnect()
        until(feed, lambda _: not feed.is_linked)
        assert feed.views()[0].state != "gone"
        near.reconnect()
        say(bus, MUGS.stat("job"), figures(evaluations=1234))
        until(feed, lambda views: feed.is_linked and views[0].figures.evaluations == 1234)
