"""The matrix role by key by verb: whether each cell is as it should be."""

from collections.abc import Iterable
from dataclasses import dataclass

from qdgrasp_coordinator.security.meetings import Meeting, allowed, givers, takers
from qdgrasp_coordinator.security.stage import ACTORS, JOB, KEYS
from qdgrasp_coordinator.security.traffic import Way
from qdgrasp_protocol.keys import ROOT

GIVES = {Way.PUT: "put", Way.QUERY: "ask", Way.TOKEN: "live"}
TAKES = {Way.PUT: "hear", Way.QUERY: "answer", Way.TOKEN: "watch"}
VERBS = tuple(verb for way in Way for verb in (GIVES[way], TAKES[way]))


@dataclass(frozen=True)
class Cell:
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


def cells(seen: set[Meeting]) -> list[Cell]:
    """The matrix, from all meetings that were seen."""
    blames = _blames(seen)
    return [
        Cell(key, verb, role, role in permitted(way, key), tuple(blames.get((key, verb, role), ())))
        for key in KEYS
        for way in Way
        for verb, permitted in ((GIVES[way], givers), (TAKES[way], takers))
        for role in ACTORS
    ]


def wide(seen: set[Meeting]) -> list[str]:
    """What went over patterns that no role may use, in words."""
    return sorted(_words(meeting) for meeting in seen if _is_wide(meeting))


def table(matrix: Iterable[Cell]) -> str:
    """The rows in which somebody is allowed something, or something is wrong."""
    rows: dict[tuple[str, str], list[Cell]] = {}
    for cell in matrix:
        rows.setdefault((cell.key, cell.verb), []).append(cell)
    width = max(len(short(key)) for key in KEYS)
    lines = ["  ".join([f"{'key':<{width}}", "verb  ", *(f"{role:<11}" for role in ACTORS)])]
    for (key, verb), row in rows.items():
        if any(cell.is_allowed or cell.wrong for cell in row):
            marks = (f"{cell.mark:<11}" for cell in row)
            lines.append("  ".join([f"{short(key):<{width}}", f"{verb:<6}", *marks]).rstrip())
    return "\n".join(lines)


def short(key: str) -> str:
    """A key without what is the same for all."""
    return key.removeprefix(f"{ROOT}/{JOB}/").replace(JOB, "*")


def _blames(seen: set[Meeting]) -> dict[tuple[str, str, str], list[str]]:
    """What is wrong, by cell: of a meeting that should not be, whoever's part in it is not allowed."""
    found: dict[tuple[str, str, str], list[str]] = {}
    due = set().union(*(allowed(way, KEYS) for way in Way))
    for meeting in sorted(seen - due, key=_words):
        if _is_wide(meeting):
            continue
        may_give = meeting.giver in givers(meeting.way, meeting.key)
        cell = _takes(meeting) if may_give else _gives(meeting)
        found.setdefault(cell, []).append(f"{_words(meeting)}, which is not allowed")
    for meeting in sorted(due - seen, key=_words):
        for cell in (_gives(meeting), _takes(meeting)):
            found.setdefault(cell, []).append(f"not seen: {_words(meeting)}")
    return found


def _gives(meeting: Meeting) -> tuple[str, str, str]:
    return meeting.key, GIVES[meeting.way], meeting.giver


def _takes(meeting: Meeting) -> tuple[str, str, str]:
    return meeting.key, TAKES[meeting.way], meeting.taker


def _is_wide(meeting: Meeting) -> bool:
    """Whether the giver or the taker used a pattern."""
    return meeting.key not in KEYS or meeting.taker not in ACTORS


def _words(meeting: Meeting) -> str:
    way, key = meeting.way, meeting.key
    return f"{meeting.giver} to {meeting.taker} ({GIVES[way]}, {TAKES[way]}) on {short(key)}"
