"""The simulated bus keeps what zenoh keeps, and loses what zenoh loses."""

from itertools import pairwise

import pytest
from tests.simulation.network import LEASE, Network, Session, Terms
from tests.simulation.world import Clock, World

from qdgrasp_coordinator.serving.inbox import LinkChange, TokenChange
from qdgrasp_protocol.bus import Channel, Sample


class Listener:
    """Hears everything."""

    def __init__(self, world: World, name: str) -> None:
        self.world = world
        self.name = name
        self.heard: list[tuple[float, object]] = []

    def hear(self, event: object) -> None:
        self.heard.append((self.world.now, event))

    @property
    def numbers(self) -> list[int]:
        return [int(event.payload) for _, event in self.heard if isinstance(event, Sample)]

    @property
    def links(self) -> list[bool]:
        return [event.up for _, event in self.heard if isinstance(event, LinkChange)]


class Pair:
    """Somebody who sends, and somebody who hears."""

    def __init__(self, terms: Terms) -> None:
        self.world = World(1)
        self.network = Network(self.world, terms)
        self.ann, self.bob = Listener(self.world, "ann"), Listener(self.world, "bob")
        self.sender, self.hearer = self.network.open(self.ann), self.network.open(self.bob)
        self.network.subscribe(self.hearer, "a/b/*")

    def send(self, number: int, session: Session | None = None) -> None:
        payload = str(number).encode()
        self.network.put(session or self.sender, "a/b/c", payload, "text", Channel.DATA)

    def run(self, seconds: float) -> None:
        until = self.world.now + seconds
        self.world.later(seconds, lambda: self.world.touched.append(self))
        self.world.run(lambda: self.world.now >= until)


def test_messages_of_a_link_arrive_in_their_order() -> None:
    pair = Pair(Terms(delay=0.5))
    for number in range(100):
        pair.send(number)
    pair.run(100)
    assert pair.bob.numbers == list(range(100))


def test_messages_may_overtake_each_other_where_the_terms_say_so() -> None:
    pair = Pair(Terms(delay=0.5, in_order=False))
    for number in range(100):
        pair.send(number)
    pair.run(100)
    assert sorted(pair.bob.numbers) == list(range(100)) != pair.bob.numbers


@pytest.mark.parametrize(
    ("terms", "least", "most"), [(Terms(loss=0.1), 1, 399), (Terms(repeat=0.1), 401, 800)]
)
def test_messages_are_lost_and_repeated_as_the_terms_say(terms: Terms, least: int, most: int) -> None:
    pair = Pair(terms)
    for number in range(400):
        pair.send(number)
    pair.run(100)
    assert least <= len(pair.bob.numbers) <= most


def test_a_link_that_is_cut_for_less_than_a_lease_only_delays() -> None:
    pair = Pair(Terms())
    pair.network.cut(pair.hearer, LEASE - 1)
    pair.send(1)
    pair.run(60)
    assert pair.bob.numbers == [1]
    assert pair.bob.heard[0][0] >= LEASE - 1
    assert pair.bob.links == []


def test_what_is_sent_over_a_link_that_breaks_is_lost_and_both_ends_notice() -> None:
    pair = Pair(Terms())
    pair.network.cut(pair.hearer, LEASE + 1)
    pair.send(1)
    pair.run(60)
    pair.send(2)
    pair.run(60)
    assert pair.bob.numbers == [2]
    assert pair.bob.links == [False, True]


def test_what_is_put_without_a_link_is_lost() -> None:
    pair = Pair(Terms())
    pair.network.drop(pair.sender)
    pair.send(1)
    pair.run(60)
    assert pair.bob.numbers == []


def test_a_token_vanishes_with_its_session_and_comes_back_with_it() -> None:
    pair = Pair(Terms())
    pair.network.watch(pair.hearer, "live/*")
    pair.network.token(pair.sender, "live/ann")
    pair.run(5)
    pair.network.restart(1.0)
    pair.run(60)
    pair.network.close(pair.sender)
    pair.run(5)
    changes = [event.alive for _, event in pair.bob.heard if isinstance(event, TokenChange)]
    assert changes == [True, False, True, False]


def test_clocks_differ_and_waiting_ends_when_they_show_it() -> None:
    world = World(0)
    clock = Clock(world, offset=1000.0, rate=0.98)
    before = clock.now
    world.now += clock.span(10.0)
    assert clock.now >= before + 10.0
    assert world.now > 10.0
    assert all(one <= other for one, other in pairwise([before, clock.now]))


def test_a_token_that_two_sessions_have_is_gone_with_the_second() -> None:
    pair = Pair(Terms())
    third = pair.network.open(Listener(pair.world, "eve"))
    pair.network.watch(pair.hearer, "live/*")
    for session in (pair.sender, third):
        pair.network.token(session, "live/twin")
    pair.run(5)
    pair.network.close(third)
    pair.run(5)
    assert [event.alive for _, event in pair.bob.heard if isinstance(event, TokenChange)] == [True, True]
    pair.network.close(pair.sender)
    pair.run(5)
    assert isinstance(pair.bob.heard[-1][1], TokenChange)
    assert not pair.bob.heard[-1][1].alive
