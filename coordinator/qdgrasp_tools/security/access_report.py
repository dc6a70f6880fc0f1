"""Reports what `qdgrasp security check` found: the matrix role by key by verb, and faults."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_protocol.keys import ROOT
from qdgrasp_protocol.session import Endpoint
from qdgrasp_tools.security import access_probe
from qdgrasp_tools.security.access_list import TrafficKind
from qdgrasp_tools.security.access_probe import PROBE_KEYS, PROBE_NAMES, allowed_givers, allowed_takers

GIVES = {TrafficKind.PUT: "put", TrafficKind.QUERY: "ask", TrafficKind.TOKEN: "live"}
TAKES = {TrafficKind.PUT: "hear", TrafficKind.QUERY: "answer", TrafficKind.TOKEN: "watch"}


@dataclass(frozen=True)
class AccessCell:
    """A role's use of one verb on one key."""

    key: str
    verb: str  # put, hear, ask, answer, live or watch
    role: str
    is_allowed: bool  # By the table of traffic
    wrong: tuple[str, ...] = ()  # Deliveries that are not allowed, or were not seen; empty: as it should be

    @property
    def mark(self) -> str:
        """Text in the printed table."""
        if self.wrong:
            return "WRONG"
        return "yes" if self.is_allowed else "-"


def access_matrix(seen: set[access_probe.Delivery]) -> list[AccessCell]:
    """Make the matrix from all deliveries that were seen."""
    faults = _faults_by_cell(seen)
    return [
        AccessCell(key, verb, role, role in permitted(kind, key), tuple(faults.get((key, verb, role), ())))
        for key in PROBE_KEYS
        for kind in TrafficKind
        for verb, permitted in ((GIVES[kind], allowed_givers), (TAKES[kind], allowed_takers))
        for role in PROBE_NAMES
    ]


def wide_deliveries(seen: set[access_probe.Delivery]) -> list[str]:
    """Describe the deliveries over patterns that no role may use."""
    return sorted(_words(delivery) for delivery in seen if _is_wide(delivery))


def matrix_table(matrix: Iterable[AccessCell]) -> str:
    """Format the rows of the matrix in which something is allowed or wrong."""
    rows: dict[tuple[str, str], list[AccessCell]] = {}
    for cell in matrix:
        rows.setdefault((cell.key, cell.verb), []).append(cell)
    width = max(len(short_key(key)) for key in PROBE_KEYS)
    lines = ["  ".join([f"{'key':<{width}}", "verb  ", *(f"{role:<11}" for role in PROBE_NAMES)])]
    for (key, verb), row in rows.items():
        if any(cell.is_allowed or cell.wrong for cell in row):
            marks = (f"{cell.mark:<11}" for cell in row)
            lines.append("  ".join([f"{short_key(key):<{width}}", f"{verb:<6}", *marks]).rstrip())
    return "\n".join(lines)


def short_key(key: str) -> str:
    """Return a key without the prefix that all keys share."""
    return key.removeprefix(f"{ROOT}/{access_probe.PROBE_JOB}/").replace(access_probe.PROBE_JOB, "*")


def _faults_by_cell(seen: set[access_probe.Delivery]) -> dict[tuple[str, str, str], list[str]]:
    """Collect the faults of each cell: deliveries that are not allowed or were not seen.

    One that is not allowed counts against the giver, or against the taker if the giver may give there.
    """
    found: dict[tuple[str, str, str], list[str]] = {}
    due = set().union(*(access_probe.allowed_deliveries(kind, PROBE_KEYS) for kind in TrafficKind))
    for delivery in sorted(seen - due, key=_words):
        if _is_wide(delivery):
            continue
        may_give = delivery.giver in allowed_givers(delivery.kind, delivery.key)
        cell = _takes(delivery) if may_give else _gives(delivery)
        found.setdefault(cell, []).append(f"{_words(delivery)}, which is not allowed")
    for delivery in sorted(due - seen, key=_words):
        for cell in (_gives(delivery), _takes(delivery)):
            found.setdefault(cell, []).append(f"not seen: {_words(delivery)}")
    return found


def _gives(delivery: access_probe.Delivery) -> tuple[str, str, str]:
    return delivery.key, GIVES[delivery.kind], delivery.giver


def _takes(delivery: access_probe.Delivery) -> tuple[str, str, str]:
    return delivery.key, TAKES[delivery.kind], delivery.taker


def _is_wide(delivery: access_probe.Delivery) -> bool:
    """Return True if the giver or the taker used a wide pattern."""
    return delivery.key not in PROBE_KEYS or delivery.taker not in PROBE_NAMES


def _words(delivery: access_probe.Delivery) -> str:
    kind, key = delivery.kind, delivery.key
    return f"{delivery.giver} to {delivery.taker} ({GIVES[kind]}, {TAKES[kind]}) on {short_key(key)}"


SESSION_SECONDS = 10.0  # seconds that opening a session may take


@dataclass(frozen=True)
class AccessReport:
    """The result of `qdgrasp security check`."""

    matrix: list[AccessCell]  # One cell for every key, verb and role
    wide: list[str]  # Deliveries over patterns that no role may use, in words
    logins: list[access_probe.LoginAttempt]

    @property
    def faults(self) -> list[str]:
        """All faults, in words."""
        wrong = [words for cell in self.matrix for words in cell.wrong]
        over = [f"by a pattern that no role may use: {words}" for words in self.wide]
        inside = [f"got in with {login.who}" for login in self.logins if login.got_in]
        return [*dict.fromkeys(wrong), *over, *inside]

    @property
    def summary(self) -> str:
        """The counts in a sentence."""
        wrong = sum(bool(cell.wrong) for cell in self.matrix)
        permitted = sum(cell.is_allowed for cell in self.matrix)
        inside = sum(login.got_in for login in self.logins)
        return (
            f"{len(self.matrix)} cells measured: {permitted} allowed, {len(self.matrix) - permitted} silent, "
            f"{wrong} wrong; {len(access_probe.WIDE_PATTERNS)} wide patterns tried by {len(PROBE_NAMES)} "
            f"roles, {len(self.wide)} leaks; "
            f"{len(self.logins)} kinds of strangers, {inside} got in."
        )


def check_access(endpoint: str, folder: Path, *, takers_at: str | None = None) -> AccessReport:
    """Probe the router on `endpoint`.

    Takers may be at a second router that relays with it, `takers_at`. `folder` is the one that `qdgrasp
    security init` wrote, with the authority's key; where it lacks a file, that raises `SecurityError`. A
    router that does not answer, or takes none of the roles, raises `EndpointError`; so do several.
    """
    for place in filter(None, (endpoint, takers_at)):
        Endpoint.parse(place)
    with access_probe.open_sessions(endpoint, folder, SESSION_SECONDS, takers_at) as sessions:
        seen = set().union(*(probe(sessions) for probe in access_probe.PROBES.values()))
    return AccessReport(access_matrix(seen), wide_deliveries(seen), access_probe.try_logins(endpoint, folder))
