"""A simulated world and its bus: sessions on links to one router, as zenoh behaves.

Time is a number, events are calls in a heap, all chance comes from one seed.
"""

import heapq
import itertools
import random
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import Protocol

from qdgrasp_protocol.bus import Channel, LinkChange, Query, Sample, TokenChange
from qdgrasp_protocol.errors import NoReply


class World:
    """Events in the order of their times."""

    def __init__(self, seed: int) -> None:
        self.now = 0.0
        self.chance = random.Random(seed)  # noqa: S311 - dice, not secrets
        self.events = 0
        self.trace: list[str] | None = None
        """Events, a line each; None: they are not noted."""
        self.touched: list[object] = []
        """Processes whose state the present event may have changed."""
        self.check: Callable[[], None] = lambda: None
        """Called after every event that touched something: it checks what must always hold."""
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()

    def at(self, time: float, call: Callable[[], None]) -> None:
        """Let something happen at a time; infinite: never."""
        if time < inf:
            heapq.heappush(self._heap, (max(time, self.now), next(self._count), call))

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Let something happen in so many seconds."""
        self.at(self.now + seconds, call)

    def run(self, is_over: Callable[[], bool]) -> None:
        """Let things happen until it is over."""
        goes_on = True
        while goes_on:
            self.now, _, call = heapq.heappop(self._heap)
            call()
            self.events += 1
            if self.touched:
                self.check()
                self.touched.clear()
                goes_on = not is_over()

    def note(self, who: str, what: str) -> None:
        """Note what happened."""
        if self.trace is not None:
            self.trace.append(f"{self.now:9.3f}  {who:<14}  {what}")

    def exponential(self, mean: float) -> float:
        """A time whose like is forgotten."""
        return self.chance.expovariate(1 / mean)


class Clock:
    """A machine's steady clock: it begins anywhere and goes a little fast or slow."""

    def __init__(self, world: World, offset: float = 0.0, rate: float = 1.0) -> None:
        self._world = world
        self._offset = offset
        self._rate = rate

    @property
    def now(self) -> float:
        """The time that it shows [s]."""
        return self._offset + self._rate * self._world.now

    def span(self, seconds: float) -> float:
        """Return the time in the world until it shows so much more, never less."""
        return max(0.0, seconds) / self._rate + 1e-9


LEASE = 4.0
"""Seconds of silence after which both ends give a link up."""


@dataclass(frozen=True)
class LinkQuality:
    """Quality of the links; probabilities are per message and link."""

    delay: float = 0.01
    """The mean of each way's time [s]."""
    loss: float = 0.0
    repeat: float = 0.0
    stall: float = 0.0
    """The probability of a delay of up to 15 s."""
    in_order: bool = True
    """Messages of one link and channel arrive in the order in which they were sent."""


@dataclass(frozen=True)
class Question:
    """A question that reached the process that answers it."""

    query: Query
    reply: Callable[[bytes | Exception], None]


class Host(Protocol):
    """Holder of a session."""

    name: str

    def hear(self, event: object) -> None:
        """Take a message, a question, a token's change or a link's."""


@dataclass(eq=False)
class Session:
    """One process's session, and its link to the router."""

    host: Host
    is_up: bool = True
    is_local: bool = False
    """The router is in its own process: the link never breaks."""
    connection: int = 0
    """Counts its links: what was sent on an older one is lost."""
    cut_until: float = 0.0
    tokens: set[str] = field(default_factory=set)
    watched: list[str] = field(default_factory=list)
    known: set[str] = field(default_factory=set)
    """The tokens it was told are alive."""
    arrivals: dict[tuple[str, Channel], float] = field(default_factory=lambda: defaultdict(float))
    """The latest arrival on each way and channel."""


def any_of(key: str) -> str:
    """The pattern of all keys that differ in their last chunk."""
    return key.rsplit("/", 1)[0] + "/*"


class Network:
    """One router, and the sessions on it."""

    def __init__(self, world: World, quality: LinkQuality) -> None:
        self._world = world
        self.quality = quality
        self.is_up = True
        """True if the router runs."""
        self.sessions: list[Session] = []
        self.recent: deque[tuple[Sample, Channel]] = deque(maxlen=50)
        """The messages put last."""
        self._subscribers: dict[str, list[Session]] = defaultdict(list)
        self._answerers: dict[str, list[Session]] = defaultdict(list)

    # Sessions come and go.

    def open(self, host: Host) -> Session:
        """Open a session."""
        session = Session(host, is_up=self.is_up)
        self.sessions.append(session)
        if not self.is_up:
            self._retry(session)
        return session

    def close(self, session: Session, *, flushed: bool = True) -> None:
        """Take back all that a session declared; what it has sent still arrives if it is flushed."""
        self.sessions.remove(session)
        for table in (self._subscribers, self._answerers):
            for sessions in table.values():
                if session in sessions:
                    sessions.remove(session)
        if not flushed:
            session.connection += 1
        was_up, session.is_up = session.is_up, False
        if was_up:
            self._announce(session.tokens, alive=False)

    def subscribe(self, session: Session, pattern: str) -> None:
        """Receive messages."""
        self._subscribers[pattern].append(session)

    def answer(self, session: Session, pattern: str) -> None:
        """Receive questions."""
        self._answerers[pattern].append(session)

    def token(self, session: Session, key: str) -> None:
        """Declare a token."""
        session.tokens.add(key)
        if session.is_up:
            self._announce({key}, alive=True)

    def hand_in(self, session: Session, key: str) -> None:
        """Take a token back."""
        session.tokens.discard(key)
        if session.is_up and session in self.sessions:
            self._announce({key}, alive=False)

    def watch(self, session: Session, pattern: str) -> None:
        """Receive changes of tokens, those alive first."""
        session.watched.append(pattern)
        if session.is_up:
            self._tell(session, {key for key in self._alive if any_of(key) == pattern}, alive=True)

    # Messages and questions.

    def put(self, session: Session, key: str, payload: bytes, encoding: str, channel: Channel) -> None:
        """Send a message to all subscribers; without a link it is lost."""
        sample = Sample(key, payload, encoding)
        if channel is not Channel.MONITOR and session.is_up:
            self.recent.append((sample, channel))
        self._travel(session, "up", channel, lambda: self._route(sample, channel))

    def repeat(self, sample: Sample, channel: Channel) -> None:
        """Deliver an old message again."""
        if self.is_up:
            self._route(sample, channel)

    def ask(
        self, session: Session, key: str, payload: bytes, reply: Callable[[bytes | Exception], None]
    ) -> None:
        """Put a question; the reply may never come."""
        query = Query(key, "", payload)
        self._travel(session, "up", Channel.DATA, lambda: self._ask(session, query, reply))

    def ask_now(self, session: Session, key: str, payload: bytes) -> bytes:
        """Put a question and have its answer at once, or `NoReply`; nothing else is done meanwhile."""
        answers: list[bytes | Exception] = []
        chance, loss = self._world.chance, self.quality.loss
        if not session.is_up or self._world.now < session.cut_until or chance.random() < loss:
            raise NoReply("there is no link")
        for other in self._reached(self._answerers, key)[:1]:
            if self._world.now >= other.cut_until:
                other.host.hear(Question(Query(key, "", payload), answers.append))
        if not answers or chance.random() < loss:
            raise NoReply("there is no answer")
        if isinstance(answers[0], Exception):
            raise answers[0]
        return answers[0]

    def _ask(self, session: Session, query: Query, reply: Callable[[bytes | Exception], None]) -> None:
        def back(answer: bytes | Exception) -> None:
            self._travel(session, "down", Channel.DATA, lambda: reply(answer))

        others = self._reached(self._answerers, query.key)
        if not others:
            back(NoReply("nobody answers"))
            return
        other = self._world.chance.choice(others)

        def answered(answer: bytes | Exception) -> None:
            self._travel(other, "up", Channel.DATA, lambda: back(answer))

        self._travel(other, "down", Channel.DATA, lambda: other.host.hear(Question(query, answered)))

    def _route(self, sample: Sample, channel: Channel) -> None:
        for session in self._reached(self._subscribers, sample.key):
            self._travel(session, "down", channel, partial(session.host.hear, sample))

    def _reached(self, table: dict[str, list[Session]], key: str) -> list[Session]:
        found = [*table.get(key, ()), *table.get(any_of(key), ())]
        return [session for session in found if session.is_up]

    def _travel(self, session: Session, way: str, channel: Channel, call: Callable[[], None]) -> None:
        """Let a message go one way of a link: in order, late, twice or never."""
        chance, quality = self._world.chance, self.quality
        if not session.is_up or (quality.loss and chance.random() < quality.loss):
            return
        self._arrive(session, way, channel, call)
        if quality.repeat and chance.random() < quality.repeat:
            self._arrive(session, way, channel, call)

    def _arrive(self, session: Session, way: str, channel: Channel, call: Callable[[], None]) -> None:
        world = self._world
        stalls = self.quality.stall and world.chance.random() < self.quality.stall
        delay = world.chance.uniform(0, 15) if stalls else world.exponential(self.quality.delay)
        time = max(world.now + delay, session.cut_until)
        if self.quality.in_order:
            time = max(time, session.arrivals[way, channel])
            session.arrivals[way, channel] = time
        self._at(session, time, call)

    def _at(self, session: Session, time: float, call: Callable[[], None]) -> None:
        """Let something happen at a time, if the link still holds then."""
        connection = session.connection
        self._world.at(time, lambda: call() if session.connection == connection else None)

    # Tokens: kept by the router, told in order.

    @property
    def _alive(self) -> set[str]:
        return {key for session in self.sessions if session.is_up for key in session.tokens}

    def _announce(self, keys: set[str], *, alive: bool) -> None:
        """Tell all who watch; a key is gone when the last session that had it is."""
        keys = keys if alive else keys - self._alive
        for session in self.sessions:
            if session.is_up and session.watched:
                self._tell(session, keys, alive=alive)

    def _tell(self, session: Session, keys: set[str], *, alive: bool) -> None:
        for key in sorted(keys):
            if any_of(key) in session.watched:
                self._travel_token(session, key, alive)

    def _travel_token(self, session: Session, key: str, alive: bool) -> None:
        """Tokens are never lost while the link holds."""

        def told() -> None:
            (session.known.add if alive else session.known.discard)(key)
            session.host.hear(TokenChange(key, alive))

        time = max(
            self._world.now + self._world.exponential(self.quality.delay),
            session.cut_until,
            session.arrivals["tokens", Channel.CONTROL],
        )
        session.arrivals["tokens", Channel.CONTROL] = time
        self._at(session, time, told)

    # Links break and mend.

    def cut(self, session: Session, seconds: float) -> None:
        """Let nothing pass a link for a while; both ends notice after a lease."""
        world = self._world
        if not session.is_up or session.is_local:
            return
        session.cut_until = max(session.cut_until, world.now + seconds)
        world.note(session.host.name, f"link cut for {seconds:.1f} s")
        self._at(session, world.now + LEASE, lambda: self._give_up(session))

    def _give_up(self, session: Session) -> None:
        if self._world.now < session.cut_until:
            self.drop(session)

    def drop(self, session: Session, *, known: bool = True) -> None:
        """Break a link, which comes back soon; its process tries again only if that is known to it."""
        if not session.is_up or session.is_local:
            return
        session.is_up = False
        session.connection += 1
        self._announce(session.tokens, alive=False)
        if known:
            self.notice(session)

    def notice(self, session: Session) -> None:
        """Tell a process that its link is down."""
        self._world.note(session.host.name, "link down")
        session.host.hear(LinkChange(False))
        for key in sorted(session.known):
            session.host.hear(TokenChange(key, False))
        session.known.clear()
        self._retry(session)

    def _retry(self, session: Session) -> None:
        wait = self._world.chance.uniform(0.1, 1.0)
        self._world.at(max(self._world.now, session.cut_until) + wait, lambda: self._connect(session))

    def _connect(self, session: Session) -> None:
        if session not in self.sessions or session.is_up:
            return
        if not self.is_up:
            self._retry(session)
            return
        session.is_up = True
        session.connection += 1
        session.arrivals.clear()
        self._world.note(session.host.name, "link up")
        session.host.hear(LinkChange(True))
        self._announce(session.tokens, alive=True)
        if session.watched:
            self._tell(session, self._alive - session.tokens, alive=True)

    def restart(self, seconds: float) -> None:
        """Let the router die, and another one come up."""
        self.go_down()
        self._world.later(seconds, self.come_up)

    def go_down(self) -> None:
        """Let the router die."""
        if not self.is_up:
            return
        self._world.note("router", "gone")
        self.is_up = False
        for session in list(self.sessions):
            session.connection += 1
            if session.is_up:
                session.is_up = False
                self.notice(session)

    def come_up(self) -> None:
        """Let a router come up."""
        self._world.note("router", "there")
        self.is_up = True
