"""Probes a running router: sessions of every role try every verb on every key.

Each role has three sessions: one gives, one takes, and one takes by patterns that are wider than any role's
rights. A session hears itself without a router, so none of them does two of these.

What is allowed must arrive, and that it does shows that the router has dealt with what was tried before it
on the same link. Then a quiet while must pass in which nothing else arrives. Who shows no certificate,
another authority's or an expired one, or a link without encryption, must not get a session at all.
"""

import ssl
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Condition
from time import monotonic

from qdgrasp_coordinator.security import authority
from qdgrasp_coordinator.security.access_list import TRAFFIC, Traffic, TrafficKind
from qdgrasp_coordinator.security.authority import CertificateIdentity
from qdgrasp_coordinator.security.folder import SecurityFolder, write_private_file
from qdgrasp_protocol.bus import Bus, Query, QueryHandler, Sample, SampleHandler, TokenHandler
from qdgrasp_protocol.errors import EndpointError, NoReply, Refused
from qdgrasp_protocol.keys import matches
from qdgrasp_protocol.session import Credentials, Endpoint, Role, shake_hands
from qdgrasp_protocol.zenoh_bus import ZenohBus

PROBE_JOB = "security-check"
NO_ROLE = "guest"  # Has a certificate of the authority, and no role
PROBE_ROLES = tuple(role for role in Role if role is not Role.ROUTER)
PROBE_NAMES = (*(role.value for role in PROBE_ROLES), NO_ROLE)
PROBE_KEYS = tuple(dict.fromkeys(flow.key.replace("**", "job").replace("*", PROBE_JOB) for flow in TRAFFIC))
"""One key of each kind of traffic, of a job that nobody serves: no number is an epoch here."""
WIDE_PATTERNS = (
    "**",
    "qdgrasp/**",
    "qdgrasp/v1/**",
    f"qdgrasp/v1/{PROBE_JOB}/**",
    f"qdgrasp/v1/{PROBE_JOB}/*",
    f"qdgrasp/v1/{PROBE_JOB}/live/**",
    f"qdgrasp/v1/{PROBE_JOB}/rpc/*",
    f"qdgrasp/v1/{PROBE_JOB}/rec/**",
    *(f"**/{verbatim}/**" for verbatim in ("@work", "@result", "@ctl", "@outcome", "@asset", "@recorded")),
    f"qdgrasp/*/{PROBE_JOB}/@work/*",
    f"qdgrasp/*/{PROBE_JOB}/@result/*",
)
"""Patterns that no role may use."""


@dataclass(frozen=True)
class ProbeReceiver:
    """A session that hears, answers and watches.

    Attributes
    ----------
    name
        Whose it is.
    bus
        The session.
    patterns
        What it declares.
    """

    name: str
    bus: Bus
    patterns: tuple[str, ...]


@dataclass(frozen=True)
class ProbeSessions:
    """Who gives and who takes."""

    givers: dict[str, Bus]
    takers: list[ProbeReceiver]


@contextmanager
def open_sessions(
    endpoint: str, folder: Path, patience: float, takers_at: str | None = None
) -> Iterator[ProbeSessions]:
    """Open all sessions at a router.

    Parameters
    ----------
    endpoint
        Of the router.
    folder
        What `qdgrasp security init` wrote, with the authority's key.
    patience
        Seconds that opening a session may take.
    takers_at
        Of another router for those who take; None: the same one.
    """
    with ExitStack() as stack:
        proofs: dict[str, Credentials] = {role.value: _credentials(folder, role) for role in PROBE_ROLES}
        proofs[NO_ROLE] = stack.enter_context(
            temporary_certificate(SecurityFolder(folder).authority, NO_ROLE)
        )

        def enter(name: str, where: str) -> Bus:
            return stack.enter_context(ZenohBus.connect(where, patience, credentials=proofs[name]))

        there = takers_at or endpoint
        givers = {name: enter(name, endpoint) for name in PROBE_NAMES}
        takers = [ProbeReceiver(name, enter(name, there), PROBE_KEYS) for name in PROBE_NAMES]
        wide = [
            ProbeReceiver(f"{name}, by a wide pattern", enter(name, there), WIDE_PATTERNS)
            for name in PROBE_NAMES
        ]
        yield ProbeSessions(givers, takers + wide)


@contextmanager
def temporary_certificate(
    signer: CertificateIdentity,
    common_name: str,
    *,
    trusts: CertificateIdentity | None = None,
    now: datetime | None = None,
) -> Iterator[Credentials]:
    """A certificate of our making, in a folder of its own, for as long as the context lasts.

    Parameters
    ----------
    signer
        The authority that issues it.
    trusts
        The authority whose routers are trusted; None: the same.
    now
        When it is issued, for a day.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        files = Credentials(Path(name), Role.WORKER)
        identity = authority.issue_certificate(signer, common_name, 1, now=now)
        write_private_file(files.authority, (trusts or signer).certificate_pem)
        write_private_file(files.certificate, identity.certificate_pem)
        write_private_file(files.key, identity.key_pem)
        yield files


def _credentials(folder: Path, role: Role) -> Credentials:
    found = Credentials(folder.absolute(), role)
    found.check()
    return found


@dataclass(frozen=True)
class Delivery:
    """Something went from one session to another.

    Attributes
    ----------
    way
        How.
    key
        On which key.
    giver
        Who published, asked or was alive.
    taker
        Who heard, answered or watched.
    """

    way: TrafficKind
    key: str
    giver: str
    taker: str


def allowed_givers(way: TrafficKind, key: str, traffic: Iterable[Traffic] = TRAFFIC) -> frozenset[str]:
    """Who may publish, ask or be alive on a key."""
    return frozenset(
        role for flow in traffic if flow.way is way and matches(flow.key, key) for role in flow.givers
    )


def allowed_takers(way: TrafficKind, key: str, traffic: Iterable[Traffic] = TRAFFIC) -> frozenset[str]:
    """Who may hear, answer or watch a key."""
    return frozenset(
        role for flow in traffic if flow.way is way and matches(flow.key, key) for role in flow.takers
    )


def allowed_deliveries(way: TrafficKind, keys: Iterable[str]) -> set[Delivery]:
    """All meetings on these keys that the table of traffic allows."""
    return {
        Delivery(way, key, giver, taker)
        for key in keys
        for giver in allowed_givers(way, key)
        for taker in allowed_takers(way, key)
    }


class DeliveryLog:
    """What was seen, noted from any thread."""

    def __init__(self) -> None:
        self._seen: set[Delivery] = set()
        self._changed = Condition()

    def add(self, meeting: Delivery) -> None:
        """Note a meeting."""
        with self._changed:
            self._seen.add(meeting)
            self._changed.notify_all()

    def wait(self, for_: set[Delivery], patience: float) -> bool:
        """Wait until all of these were seen, at most `patience` seconds; whether they were."""
        deadline = monotonic() + patience
        with self._changed:
            return self._changed.wait_for(lambda: for_ <= self._seen, max(0.0, deadline - monotonic()))

    @property
    def seen(self) -> set[Delivery]:
        """All that was seen."""
        with self._changed:
            return set(self._seen)


ENCODING = "text/plain"
DELIVERY_SECONDS = 10.0  # seconds that anything may take that is to happen
ROUND_SECONDS = 0.2  # seconds between two tries: declarations may still be on their way
QUIET_SECONDS = 0.5  # seconds in which nothing is to happen
ANSWER_SECONDS = 1.0  # seconds that an answer may take


def probe_puts(stage: ProbeSessions) -> set[Delivery]:
    """All publish on all keys while all subscribe to all of them: who heard whom."""
    heard, due = DeliveryLog(), allowed_deliveries(TrafficKind.PUT, PROBE_KEYS)
    with ExitStack() as stack:
        for taker in stage.takers:
            for pattern in taker.patterns:
                stack.enter_context(taker.bus.subscribe(pattern, _hearer(taker, heard)))
        for _ in _rounds(heard, due):
            for giver, bus in stage.givers.items():
                for key in (*WIDE_PATTERNS, *PROBE_KEYS):
                    bus.put(key, giver.encode(), encoding=ENCODING)
    return heard.seen


def probe_queries(stage: ProbeSessions) -> set[Delivery]:
    """All ask all keys while one after the other answers on all of them: who was answered by whom.

    What is allowed counts when the question and the answer arrived, anything else when one of them did.
    """
    asked, answered, due = DeliveryLog(), DeliveryLog(), allowed_deliveries(TrafficKind.QUERY, PROBE_KEYS)
    for taker in stage.takers:
        with ExitStack() as stack:
            for pattern in taker.patterns:
                stack.enter_context(taker.bus.answer(pattern, _answerer(taker, asked)))
            for _ in _rounds(answered, {meeting for meeting in due if meeting.taker == taker.name}):
                for giver, bus in stage.givers.items():
                    _ask_all(giver, bus, answered)
    both, any_ = asked.seen & answered.seen, asked.seen | answered.seen
    return both | (any_ - due)


def probe_tokens(stage: ProbeSessions) -> set[Delivery]:
    """One after the other is alive on all keys while all watch them: who saw whom."""
    found = set()
    for giver, bus in stage.givers.items():
        seen, due = (
            DeliveryLog(),
            {
                meeting
                for meeting in allowed_deliveries(TrafficKind.TOKEN, PROBE_KEYS)
                if meeting.giver == giver
            },
        )
        with ExitStack() as stack:
            for key in PROBE_KEYS:
                stack.enter_context(bus.token(key))
            for taker in stage.takers:
                for pattern in taker.patterns:
                    stack.enter_context(taker.bus.watch(pattern, _watcher(giver, taker, seen)))
            seen.wait(due, DELIVERY_SECONDS)
            time.sleep(QUIET_SECONDS)
        time.sleep(QUIET_SECONDS)  # until nobody sees these tokens any more
        found |= seen.seen
    return found


PROBES = {TrafficKind.PUT: probe_puts, TrafficKind.QUERY: probe_queries, TrafficKind.TOKEN: probe_tokens}


def _rounds(notes: DeliveryLog, due: set[Delivery]) -> Iterator[None]:
    """Rounds of tries: until everything that is due was seen, and once more; and a quiet while after it."""
    deadline = time.monotonic() + DELIVERY_SECONDS
    yield
    while not notes.wait(due, ROUND_SECONDS) and time.monotonic() < deadline:
        yield
    yield
    time.sleep(QUIET_SECONDS)


def _ask_all(giver: str, bus: Bus, answered: DeliveryLog) -> None:
    """Ask every key once."""
    for key in (*WIDE_PATTERNS, *PROBE_KEYS):
        with suppress(NoReply, Refused):
            taker = bus.ask(key, giver.encode(), timeout=ANSWER_SECONDS).decode(errors="replace")
            answered.add(Delivery(TrafficKind.QUERY, key, giver, taker))


def _hearer(taker: ProbeReceiver, heard: DeliveryLog) -> SampleHandler:
    def hear(sample: Sample) -> None:
        giver = sample.payload.decode(errors="replace")
        if giver in PROBE_NAMES:
            heard.add(Delivery(TrafficKind.PUT, sample.key, giver, taker.name))

    return hear


def _answerer(taker: ProbeReceiver, asked: DeliveryLog) -> QueryHandler:
    def answer(query: Query) -> bytes:
        giver = query.payload.decode(errors="replace")
        if giver not in PROBE_NAMES:
            raise NoReply("not a question of this check")
        asked.add(Delivery(TrafficKind.QUERY, query.key, giver, taker.name))
        return taker.name.encode()

    return answer


def _watcher(giver: str, taker: ProbeReceiver, seen: DeliveryLog) -> TokenHandler:
    def watch(key: str, alive: bool) -> None:
        if alive and key in PROBE_KEYS:
            seen.add(Delivery(TrafficKind.TOKEN, key, giver, taker.name))

    return watch


LOGIN_SECONDS = 1.0  # seconds that opening a session may take
LONG_AGO = timedelta(days=2)  # A certificate that was issued then for a day has expired


@dataclass(frozen=True)
class LoginAttempt:
    """Somebody who tried to get in.

    Attributes
    ----------
    who
        In words.
    got_in
        A session was opened, which is wrong.
    """

    who: str
    got_in: bool


def try_logins(endpoint: str, folder: Path) -> list[LoginAttempt]:
    """Knock as every kind of stranger, and as one who is welcome.

    Raises
    ------
    EndpointError
        The one who is welcome does not get in either: the router is away, or slower than we wait.
    """
    ours, theirs, now = SecurityFolder(folder).authority, authority.create_authority(1), datetime.now(UTC)
    tried = [
        LoginAttempt("no certificate", _greets(endpoint, folder)),
        LoginAttempt("a worker's certificate of another authority", _opens(endpoint, theirs, ours, now)),
        LoginAttempt("a worker's certificate that has expired", _opens(endpoint, ours, ours, now - LONG_AGO)),
        LoginAttempt("a link without encryption", _connects(f"tcp/{endpoint.partition('/')[2]}", None)),
    ]
    if not _opens(endpoint, ours, ours, now):
        raise EndpointError(
            f"It cannot be said whether strangers get in at {endpoint}: a good certificate does not within "
            f"{LOGIN_SECONDS:g} s either. Try again when the router is there and less busy."
        )
    return tried


def _greets(endpoint: str, folder: Path) -> bool:
    """Whether a router takes somebody who shows nothing."""
    known = Credentials(folder, Role.WORKER)
    try:
        return shake_hands(Endpoint.parse(endpoint), ssl.create_default_context(cafile=str(known.authority)))
    except OSError:  # of TLS, or of a link that was ended without a word
        return False


def _opens(
    endpoint: str, signer: CertificateIdentity, trusted: CertificateIdentity, issued: datetime
) -> bool:
    """Whether a router takes a worker's certificate of this signer."""
    with temporary_certificate(signer, Role.WORKER.common_name, trusts=trusted, now=issued) as shown:
        return _connects(endpoint, shown)


def _connects(endpoint: str, shown: Credentials | None) -> bool:
    try:
        with ZenohBus.connect(endpoint, LOGIN_SECONDS, credentials=shown):
            return True
    except EndpointError:
        return False
