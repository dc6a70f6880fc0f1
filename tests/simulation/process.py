"""Simulated processes, which hear, wait and work on the simulated network."""

from collections import deque
from collections.abc import Generator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import inf

from tests.simulation.invariants import InvariantViolated
from tests.simulation.network import Clock, Network, World

from qdgrasp_protocol.bus import Bus, Channel, Declaration


@dataclass(frozen=True)
class Listen:
    """Wait until something is in the inbox, or for so many seconds of the own clock."""

    seconds: float = inf


@dataclass(frozen=True)
class Busy:
    """Work for so many seconds, without reading the inbox."""

    seconds: float


SHORT, MOST_SHORT = 1e-3, 20
"""Seconds that count as no wait, and the most such waits in a row with nothing to do."""
Steps = Generator[Listen | Busy, None, None]


@dataclass
class SessionBus:
    """The part of a bus that a process needs."""

    host: "Process"

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        self.host.network.put(self.host.session, key, payload, encoding, channel)

    def ask(self, key: str, payload: bytes, *, timeout: float) -> bytes:
        return self.host.network.ask_now(self.host.session, key, payload)

    def token(self, key: str) -> AbstractContextManager[None]:
        self.host.network.token(self.host.session, key)
        return Declaration(lambda: self.host.network.hand_in(self.host.session, key))


class Process:
    """A process on a machine of its own, with a session on the bus."""

    def __init__(self, world: World, network: Network, name: str) -> None:
        chance = world.chance
        self.world = world
        self.network = network
        self.name = name
        self.clock = Clock(world, chance.uniform(0, 1e6), chance.uniform(0.98, 1.02))
        self.inbox: deque[object] = deque()
        self.is_over = False
        """It has ended or was killed."""
        self.is_frozen = False
        self.session = network.open(self)
        self.bus: Bus = SessionBus(self)  # type: ignore[assignment]
        self._step_iterator = self.steps()
        self._waits = 0  # waits are numbered: the end of an older one has no effect
        self._is_listening = False
        self._owed: int | None = None
        self._idle = 0
        world.later(0.0, lambda: self._go(0))

    @property
    def now(self) -> float:
        """The time on its clock."""
        return self.clock.now

    @property
    def is_running(self) -> bool:
        """It is there, and not frozen."""
        return not (self.is_over or self.is_frozen)

    def steps(self) -> Steps:
        """Act from the start to the end."""
        raise NotImplementedError

    def note(self, what: str) -> None:
        """Note what happened."""
        self.world.note(self.name, what)

    def hear(self, event: object) -> None:
        """Take something into the inbox."""
        if self.is_over:
            return
        self.inbox.append(event)
        if self._is_listening and not self.is_frozen:
            self._wake()

    def events(self) -> list[object]:
        """Everything in the inbox, taken out."""
        events = list(self.inbox)
        self.inbox.clear()
        return events

    # It ends, or is stopped for a while.

    def end(self, *, flushed: bool = True) -> None:
        """End, by itself or by SIGKILL."""
        if not self.is_over:
            self._be_over()
            self.network.close(self.session, flushed=flushed)

    def lose_power(self) -> None:
        """End without a message to other processes."""
        if not self.is_over:
            self._be_over()
            self.session.connection += 1
            self.session.cut_until = inf
            self.world.later(4.0, lambda: self.network.close(self.session))

    def freeze(self, seconds: float) -> None:
        """SIGSTOP, and SIGCONT later; a link to it does not outlast a lease."""
        if not self.is_running:
            return
        self.note(f"frozen for {seconds:.1f} s")
        self.is_frozen = True
        connection = self.session.connection
        self.world.later(4.0, lambda: self._let_go(connection))
        self.world.later(seconds, self._thaw)

    def _be_over(self) -> None:
        self.note("dies")
        self.is_over = True
        if not self._step_iterator.gi_running:
            self._step_iterator.close()

    def _let_go(self, connection: int) -> None:
        if self.is_frozen and not self.is_over and self.session.connection == connection:
            self.network.drop(self.session, known=False)

    def _thaw(self) -> None:
        if self.is_over:
            return
        self.note("goes on")
        self.is_frozen = False
        if not self.session.is_up:
            self.network.notice(self.session)
        if self._owed is not None:
            owed, self._owed = self._owed, None
            self._go(owed)
        elif self._is_listening and self.inbox:
            self._wake()

    # It goes on.

    def _wake(self) -> None:
        self._is_listening = False
        wait = self._waits
        self.world.later(0.0, lambda: self._go(wait))

    def _go(self, wait: int) -> None:
        """Go on after a wait."""
        if self.is_over or wait != self._waits:
            return
        if self.is_frozen:
            self._owed = wait
            return
        self._waits += 1
        self._is_listening = False
        self.world.touched.append(self)
        try:
            request = next(self._step_iterator)
        except StopIteration:
            self.end()
            return
        self._wait_for(request)

    def _check_rest(self, seconds: float) -> None:
        """Check that it does not spin, where it has heard all and waits for so many seconds."""
        self._idle = 0 if self.inbox or seconds > SHORT else self._idle + 1
        if self._idle > MOST_SHORT:
            raise InvariantViolated(
                "no machine spins", f"{self.name} has nothing to do, and waits for nothing"
            )

    def _wait_for(self, request: Listen | Busy) -> None:
        wait = self._waits
        match request:
            case Busy(seconds):
                self.world.later(self.clock.span(seconds), lambda: self._go(wait))
            case Listen(seconds):
                self._check_rest(seconds)
                if self.inbox:
                    self.world.later(0.0, lambda: self._go(wait))
                    return
                self._is_listening = True
                self.world.later(self.clock.span(seconds), lambda: self._go(wait))
