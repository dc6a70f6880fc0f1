"""Reports what `qdgrasp security check` found: the matrix role by key by verb, and faults."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.security.access_list import TrafficKind
from qdgrasp_coordinator.security.access_probe import (
    PROBE_JOB,
    PROBE_KEYS,
    PROBE_NAMES,
    PROBES,
    WIDE_PATTERNS,
    Delivery,
    LoginAttempt,
    allowed_deliveries,
    allowed_givers,
    allowed_takers,
    open_sessions,
    try_logins,
)
from qdgrasp_protocol.keys import ROOT
from qdgrasp_protocol.session import Endpoint

GIVES = {TrafficKind.PUT: "put", TrafficKind.QUERY: "ask", TrafficKind.TOKEN: "live"}
TAKES = {TrafficKind.PUT: "hear", TrafficKind.QUERY: "answer", TrafficKind.TOKEN: "watch"}
VERBS = tuple(verb for way in TrafficKind for verb in (GIVES[way], TAKES[way]))


@dataclass(frozen=True)
class AccessCell:
    """What one role does with one key.

    Attributes
    ----------
    key
        The key.
    verb
        What: put, hear, ask, answer, live, watch.
    role
        Who.
    is_allowed
        By the table of traffic.
    wrong
        What was seen that should not have been, or was not seen; empty where all is as it should be.
    """

    key: str
    verb: str
    role: str
    is_allowed: bool
    wrong: tuple[str, ...] = ()

    @property
    def mark(self) -> str:
        """What the printed table shows."""
        if self.wrong:
            return "WRONG"
        return "yes" if self.is_allowed else "-"


def access_matrix(seen: set[Delivery]) -> list[AccessCell]:
    """The matrix, from all meetings that were seen."""
    blames = _faults_by_cell(seen)
    return [
        AccessCell(key, verb, role, role in permitted(way, key), tuple(blames.get((key, verb, role), ())))
        for key in PROBE_KEYS
        for way in TrafficKind
        for verb, permitted in ((GIVES[way], allowed_givers), (TAKES[way], allowed_takers))
        for role in PROBE_NAMES
    ]


def wide_deliveries(seen: set[Delivery]) -> list[str]:
    """What went over patterns that no role may use, in words."""
    return sorted(_words(meeting) for meeting in seen if _is_wide(meeting))


def matrix_table(matrix: Iterable[AccessCell]) -> str:
    """The rows in which somebody is allowed something, or something is wrong."""
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
    """A key without what is the same for all."""
    return key.removeprefix(f"{ROOT}/{PROBE_JOB}/").replace(PROBE_JOB, "*")


def _faults_by_cell(seen: set[Delivery]) -> dict[tuple[str, str, str], list[str]]:
    """What is wrong, by cell: of a meeting that should not be, whoever's part in it is not allowed."""
    found: dict[tuple[str, str, str], list[str]] = {}
    due = set().union(*(allowed_deliveries(way, PROBE_KEYS) for way in TrafficKind))
    for meeting in sorted(seen - due, key=_words):
        if _is_wide(meeting):
            continue
        may_give = meeting.giver in allowed_givers(meeting.way, meeting.key)
        cell = _takes(meeting) if may_give else _gives(meeting)
        found.setdefault(cell, []).append(f"{_words(meeting)}, which is not allowed")
    for meeting in sorted(due - seen, key=_words):
        for cell in (_gives(meeting), _takes(meeting)):
            found.setdefault(cell, []).append(f"not seen: {_words(meeting)}")
    return found


def _gives(meeting: Delivery) -> tuple[str, str, str]:
    return meeting.key, GIVES[meeting.way], meeting.giver


def _takes(meeting: Delivery) -> tuple[str, str, str]:
    return meeting.key, TAKES[meeting.way], meeting.taker


def _is_wide(meeting: Delivery) -> bool:
    """Whether the giver or the taker used a pattern."""
    return meeting.key not in PROBE_KEYS or meeting.taker not in PROBE_NAMES


def _words(meeting: Delivery) -> str:
    way, key = meeting.way, meeting.key
    return f"{meeting.giver} to {meeting.taker} ({GIVES[way]}, {TAKES[way]}) on {short_key(key)}"


SESSION_SECONDS = 10.0  # seconds that opening a session may take


@dataclass(frozen=True)
class AccessReport:
    """What was found.

    Attributes
    ----------
    matrix
        Every key, verb and role.
    wide
        What went over patterns that no role may use.
    knocks
        Who tried to get in without a session being theirs to have.
    """

    matrix: list[AccessCell]
    wide: list[str]
    knocks: list[LoginAttempt]

    @property
    def faults(self) -> list[str]:
        """All that is not as it should be, in words."""
        told = [words for cell in self.matrix for words in cell.wrong]
        over = [f"by a pattern that nobody may use: {words}" for words in self.wide]
        inside = [f"got in with {knock.who}" for knock in self.knocks if knock.got_in]
        return [*dict.fromkeys(told), *over, *inside]

    @property
    def holds(self) -> bool:
        """Everything was as it should be."""
        return not self.faults

    @property
    def words(self) -> str:
        """A summary in a sentence."""
        wrong = sum(bool(cell.wrong) for cell in self.matrix)
        permitted = sum(cell.is_allowed for cell in self.matrix)
        inside = sum(knock.got_in for knock in self.knocks)
        return (
            f"{len(self.matrix)} cells measured: {permitted} allowed, {len(self.matrix) - permitted} silent, "
            f"{wrong} wrong; {len(WIDE_PATTERNS)} wide patterns tried by {len(PROBE_NAMES)} "
            f"roles, {len(self.wide)} leaks; "
            f"{len(self.knocks)} kinds of strangers, {inside} got in."
        )


def check_access(endpoint: str, folder: Path, *, takers_at: str | None = None) -> AccessReport:
    """Try everything at the router on `endpoint`.

    Parameters
    ----------
    endpoint
        Of the router.
    folder
        What `qdgrasp security init` wrote, with the authority's key.
    takers_at
        Of a second router, which relays with the first: those who take are its clients; None: one router.

    Raises
    ------
    EndpointError
        The router does not answer, or takes none of the roles; or several were named.
    SecurityError
        The folder lacks a file.
    """
    for place in filter(None, (endpoint, takers_at)):
        Endpoint.parse(place)
    with open_sessions(endpoint, folder, SESSION_SECONDS, takers_at) as actors:
        seen = set().union(*(attempt(actors) for attempt in PROBES.values()))
    return AccessReport(access_matrix(seen), wide_deliveries(seen), try_logins(endpoint, folder))
