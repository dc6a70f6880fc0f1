"""Simulated processes, and the invariants that must hold after every event."""

from collections import deque
from collections.abc import Generator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import inf

from tests.simulation.network import Clock, Network, World

from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_protocol.bus import Bus, Channel, Declaration
from qdgrasp_protocol.rows import Genomes, Rows


class InvariantViolated(AssertionError):
    """An invariant, by its name, does not hold; `words` say what was seen."""

    def __init__(self, invariant: str, words: str) -> None:
        super().__init__(f"{invariant}: {words}")
        self.invariant = invariant


class CheckedSearch:
    """A search that insists on the order in which it is asked and told, so many generations in flight."""

    def __init__(self, search: SearchAlgorithm, in_flight: int) -> None:
        self._search = search
        self._in_flight = in_flight
        self._asked: deque[int] = deque()
        """Numbers of genomes of the generations that are asked and not told."""
        self._told = 0

    def ask(self, generation: int) -> Genomes:
        """Generation g is asked when generation g - L has been told."""
        is_next = generation == self._told + len(self._asked) and len(self._asked) < self._in_flight
        if not is_next:
            raise InvariantViolated("told in order", f"asked {generation} with {self._told} told")
        genomes = self._search.ask(generation)
        self._asked.append(len(genomes))
        return genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Generations in order, each once and whole, by index."""
        whole = bool(self._asked) and rows["index"].tolist() == list(range(self._asked.popleft()))
        if generation != self._told or not whole or (rows["generation"] != generation).any():
            raise InvariantViolated(
                "told in order", f"told {generation} after {self._told - 1}, {rows['index']}"
            )
        self._told += 1
        self._search.tell(generation, rows)


INVARIANTS = {
    "no machine fails": "no state machine raises what its callers do not expect",
    "no machine spins": "nobody looks up again and again with nothing heard and nothing to do",
    "settled once": "every batch is settled at most once, by a worker that was leased it, with its true rows",
    "nothing is lost": "every row that was asked and is not settled waits or is leased, in one place",
    "told in order": "the search is asked and told generation by generation, index by index, L in flight",
    "true journal": "the disk holds a beginning of the undisturbed journal",
    "recorded before forgotten": "the outbox keeps every row that is not on the disk",
    "acknowledged when durable": "no number is reported that is not on the disk",
    "epochs rise": "each turn has an epoch of its own; no rows of a lower one than the last are taken",
    "fenced": "a worker holds nothing of another epoch, or of an older join that it did not list then",
    "bounded work": "nobody is leased more than its credit, or holds more but what was taken back unheard",
    "bounded memory": "no container grows beyond its stated bound",
    "work is handed out": "no worker with credit waits while a batch does",
    "patience while cut off": "nobody is given up while the coordinator's own link is down",
    "progress": "with one worker left and nothing going wrong, rows are recorded, to the end",
}


def require(holds: bool, invariant: str, *words: object) -> None:
    """Check one thing, or raise `InvariantViolated`."""
    if not holds:
        raise InvariantViolated(invariant, " ".join(map(str, words)))


@dataclass(frozen=True)
class Listen:
    """Wait until something is in the inbox, or for so many seconds of the own clock."""

    seconds: float = inf


@dataclass(frozen=True)
class Busy:
    """Be at work for so many seconds, and hear nothing meanwhile."""

    seconds: float


SHORT, MOST_SHORT = 1e-3, 20
"""Seconds that count as no wait, and the most such waits in a row with nothing to do."""
Life = Generator[Listen | Busy, None, None]


@dataclass
class SessionBus:
    """The part of a bus that what runs in a process needs."""

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
        self._life = self.life()
        self._waits = 0  # what it waits for has a number: an older one wakes nobody
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

    def life(self) -> Life:
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
        """Be gone, by its own will or by SIGKILL."""
        if not self.is_over:
            self._be_over()
            self.network.close(self.session, flushed=flushed)

    def lose_power(self) -> None:
        """Be gone without anybody being told."""
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
        if not self._life.gi_running:
            self._life.close()

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
        """Go on with what was waited for."""
        if self.is_over or wait != self._waits:
            return
        if self.is_frozen:
            self._owed = wait
            return
        self._waits += 1
        self._is_listening = False
        self.world.touched.append(self)
        try:
            request = next(self._life)
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
