"""Probes a running router: sessions of every role try every verb on every key.

Each role has three sessions: one gives, one takes, and one takes by patterns that are wider than any role's
rights. A session receives its own messages without a router, so none of them does two of these.

Allowed messages must arrive; then the router has dealt with all that was sent before them on the same link.
After them nothing else may arrive for a while. A client without a certificate, with another authority's or
an expired one, or without encryption must not get a session at all.
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

from qdgrasp_protocol.bus import Bus, Query, QueryHandler, Sample, SampleHandler, TokenHandler
from qdgrasp_protocol.errors import EndpointError, NoReply, Refused
from qdgrasp_protocol.keys import matches
from qdgrasp_protocol.session import Credentials, Endpoint, Role, shake_hands
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.security import authority
from qdgrasp_tools.security.access_list import TRAFFIC, Traffic, TrafficKind
from qdgrasp_tools.security.authority import CertificateIdentity
from qdgrasp_tools.security.folder import SecurityFolder, write_private_file

PROBE_JOB = "security-check"
NO_ROLE = "guest"  # Has a certificate of the authority, and no role
PROBE_ROLES = tuple(role for role in Role if role is not Role.ROUTER)
PROBE_NAMES = (*(role.value for role in PROBE_ROLES), NO_ROLE)
PROBE_KEYS = tuple(dict.fromkeys(flow.key.replace("**", "job").replace("*", PROBE_JOB) for flow in TRAFFIC))
"""One key of each kind of traffic, of a job that does not exist."""
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
    """A session that subscribes, answers and watches."""

    name: str  # Its role, and the kind of its patterns
    bus: Bus
    patterns: tuple[str, ...]  # Key patterns that it declares


@dataclass(frozen=True)
class ProbeSessions:
    """Sessions of all roles at a router."""

    givers: dict[str, Bus]  # Sessions that publish, ask and are alive, by role
    takers: list[ProbeReceiver]


@contextmanager
def open_sessions(
    endpoint: str, folder: Path, patience: float, takers_at: str | None = None
) -> Iterator[ProbeSessions]:
    """Open all sessions at a router, each within `patience` seconds.

    `folder` is the one that `qdgrasp security init` wrote, with the authority's key; takers may have their
    sessions at another router, `takers_at`.
    """
    with ExitStack() as stack:
        proofs = {role.value: Credentials(folder.absolute(), role) for role in PROBE_ROLES}
        for proof in proofs.values():
            proof.check()
        ours = SecurityFolder(folder).authority
        proofs[NO_ROLE] = stack.enter_context(temporary_certificate(ours, NO_ROLE))

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
    """Issue a certificate for a day from `now`, in a folder that lasts as long as the context.

    It trusts routers of the authority `trusts`; None: of the signer.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        files = Credentials(Path(name), Role.WORKER)
        identity = authority.issue_certificate(signer, common_name, 1, now=now)
        write_private_file(files.authority, (trusts or signer).certificate_pem)
        write_private_file(files.certificate, identity.certificate_pem)
        write_private_file(files.key, identity.key_pem)
        yield files


@dataclass(frozen=True)
class Delivery:
    """One message, answer or token that went from one session to another."""

    kind: TrafficKind
    key: str
    giver: str  # Name of the session that published, asked or was alive
    taker: str  # Name of the session that received, answered or watched


def allowed_givers(kind: TrafficKind, key: str) -> frozenset[str]:
    """Return the roles that may publish, ask or be alive on a key."""
    return frozenset().union(*(flow.givers for flow in _flows(kind, key)))


def allowed_takers(kind: TrafficKind, key: str) -> frozenset[str]:
    """Return the roles that may subscribe, answer or watch on a key."""
    return frozenset().union(*(flow.takers for flow in _flows(kind, key)))


def _flows(kind: TrafficKind, key: str) -> list[Traffic]:
    return [flow for flow in TRAFFIC if flow.kind is kind and matches(flow.key, key)]


def allowed_deliveries(kind: TrafficKind, keys: Iterable[str]) -> set[Delivery]:
    """Return all deliveries on these keys that the table of traffic allows."""
    return {
        Delivery(kind, key, giver, taker)
        for key in keys
        for giver in allowed_givers(kind, key)
        for taker in allowed_takers(kind, key)
    }


class DeliveryLog:
    """Deliveries that were seen, noted from any thread."""

    def __init__(self) -> None:
        self._seen: set[Delivery] = set()
        self._changed = Condition()

    def add(self, delivery: Delivery) -> None:
        """Note a delivery."""
        with self._changed:
            self._seen.add(delivery)
            self._changed.notify_all()

    def wait(self, due: set[Delivery], patience: float) -> bool:
        """Wait at most `patience` seconds; returns True once all of these were seen."""
        with self._changed:
            return self._changed.wait_for(lambda: due <= self._seen, patience)

    @property
    def seen(self) -> set[Delivery]:
        """All deliveries so far."""
        with self._changed:
            return set(self._seen)


ENCODING = "text/plain"
DELIVERY_SECONDS = 10.0  # limit for all that must arrive
ROUND_SECONDS = 0.2  # between two tries: declarations may still be on their way
QUIET_SECONDS = 0.5  # in which nothing else may arrive
ANSWER_SECONDS = 1.0  # limit for an answer


def probe_puts(sessions: ProbeSessions) -> set[Delivery]:
    """Publish on all keys from every session while every session subscribes to all of them."""
    heard, due = DeliveryLog(), allowed_deliveries(TrafficKind.PUT, PROBE_KEYS)
    with ExitStack() as stack:
        for taker in sessions.takers:
            for pattern in taker.patterns:
                stack.enter_context(taker.bus.subscribe(pattern, _subscriber(taker, heard)))
        for _ in _rounds(heard, due):
            for giver, bus in sessions.givers.items():
                for key in (*WIDE_PATTERNS, *PROBE_KEYS):
                    bus.put(key, giver.encode(), encoding=ENCODING)
    return heard.seen


def probe_queries(sessions: ProbeSessions) -> set[Delivery]:
    """Ask all keys from every session while one session after the other answers on them.

    An allowed delivery counts if question and answer arrived, any other if one of them did.
    """
    asked, answered, due = DeliveryLog(), DeliveryLog(), allowed_deliveries(TrafficKind.QUERY, PROBE_KEYS)
    for taker in sessions.takers:
        with ExitStack() as stack:
            for pattern in taker.patterns:
                stack.enter_context(taker.bus.answer(pattern, _answerer(taker, asked)))
            for _ in _rounds(answered, {one for one in due if one.taker == taker.name}):
                for giver, bus in sessions.givers.items():
                    for key in (*WIDE_PATTERNS, *PROBE_KEYS):
                        with suppress(NoReply, Refused):
                            reply = bus.ask(key, giver.encode(), timeout=ANSWER_SECONDS)
                            name = reply.decode(errors="replace")
                            answered.add(Delivery(TrafficKind.QUERY, key, giver, name))
    both, any_ = asked.seen & answered.seen, asked.seen | answered.seen
    return both | (any_ - due)


def probe_tokens(sessions: ProbeSessions) -> set[Delivery]:
    """Declare tokens on all keys from one session after the other while every session watches."""
    found, allowed = set(), allowed_deliveries(TrafficKind.TOKEN, PROBE_KEYS)
    for giver, bus in sessions.givers.items():
        seen, due = DeliveryLog(), {delivery for delivery in allowed if delivery.giver == giver}
        with ExitStack() as stack:
            for key in PROBE_KEYS:
                stack.enter_context(bus.token(key))
            for taker in sessions.takers:
                for pattern in taker.patterns:
                    stack.enter_context(taker.bus.watch(pattern, _watcher(giver, taker, seen)))
            seen.wait(due, DELIVERY_SECONDS)
            time.sleep(QUIET_SECONDS)
        time.sleep(QUIET_SECONDS)  # until these tokens are gone everywhere
        found |= seen.seen
    return found


PROBES = {TrafficKind.PUT: probe_puts, TrafficKind.QUERY: probe_queries, TrafficKind.TOKEN: probe_tokens}


def _rounds(notes: DeliveryLog, due: set[Delivery]) -> Iterator[None]:
    """Yield for each try: until all due deliveries were seen, and once more; then wait a while."""
    deadline = time.monotonic() + DELIVERY_SECONDS
    yield
    while not notes.wait(due, ROUND_SECONDS) and time.monotonic() < deadline:
        yield
    yield
    time.sleep(QUIET_SECONDS)


def _subscriber(taker: ProbeReceiver, heard: DeliveryLog) -> SampleHandler:
    def take(sample: Sample) -> None:
        giver = sample.payload.decode(errors="replace")
        if giver in PROBE_NAMES:
            heard.add(Delivery(TrafficKind.PUT, sample.key, giver, taker.name))

    return take


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


LOGIN_SECONDS = 1.0  # limit for opening a session
LONG_AGO = timedelta(days=2)  # a certificate that was issued then for a day has expired


@dataclass(frozen=True)
class LoginAttempt:
    """An attempt to open a session without the right to one."""

    who: str  # The certificate that was shown, in words
    got_in: bool  # A session was opened, which is wrong


def try_logins(endpoint: str, folder: Path) -> list[LoginAttempt]:
    """Try to open a session with every kind of bad certificate, and with a good one.

    Raises `EndpointError` where the good one opens no session either: the router is away, or slower than
    `LOGIN_SECONDS`.
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
    """Return True if a router accepts a client without a certificate."""
    known = Credentials(folder, Role.WORKER)
    try:
        return shake_hands(Endpoint.parse(endpoint), ssl.create_default_context(cafile=str(known.authority)))
    except OSError:  # of TLS, or of a link that was ended without a word
        return False


def _opens(endpoint: str, signer: CertificateIdentity, trusts: CertificateIdentity, issued: datetime) -> bool:
    """Return True if a router accepts a worker's certificate of this signer."""
    with temporary_certificate(signer, Role.WORKER.common_name, trusts=trusts, now=issued) as shown:
        return _connects(endpoint, shown)


def _connects(endpoint: str, shown: Credentials | None) -> bool:
    try:
        with ZenohBus.connect(endpoint, LOGIN_SECONDS, credentials=shown):
            return True
    except EndpointError:
        return False
