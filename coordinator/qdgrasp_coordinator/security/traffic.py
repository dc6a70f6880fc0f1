"""Who says what to whom: the one table that access lists and size limits are made from.

A row stands for the keys of all jobs. Rows add up: who may hear what another row's givers publish is who
has a row that matches its key. What is not in the table is denied.
"""

from dataclasses import dataclass
from enum import StrEnum

from qdgrasp_protocol.codec import MAX_PAYLOAD
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.keys import AnyJob

JOBS = AnyJob()
KIB, MIB = 1 << 10, 1 << 20
COORDINATOR, RECORDER, WORKER = Role.COORDINATOR, Role.RECORDER, Role.WORKER
WATCHERS = frozenset({Role.MONITOR, Role.ADMIN})


class Way(StrEnum):
    """How two sides meet on a key."""

    PUT = "put"
    """One publishes, the others hear."""
    QUERY = "query"
    """One asks, the others answer."""
    TOKEN = "token"  # noqa: S105  # a sign of life
    """One is alive, the others watch."""


@dataclass(frozen=True)
class Traffic:
    """One kind of traffic.

    Attributes
    ----------
    key
        A pattern over the keys of all jobs.
    way
        How the two sides meet.
    givers
        Who publishes, asks, or is alive.
    takers
        Who hears, answers, or watches.
    limit
        The most bytes of what is published or asked.
    answer_limit
        The most bytes of an answer.
    """

    key: str
    way: Way
    givers: frozenset[Role]
    takers: frozenset[Role]
    limit: int = 0
    answer_limit: int = 0


def _put(key: str, givers: set[Role], takers: set[Role] | frozenset[Role], limit: int) -> Traffic:
    return Traffic(key, Way.PUT, frozenset(givers), frozenset(takers), limit)


def _query(
    key: str, askers: set[Role] | frozenset[Role], answerers: set[Role], limit: int, answer: int
) -> Traffic:
    return Traffic(key, Way.QUERY, frozenset(askers), frozenset(answerers), limit, answer)


def _token(key: str, holder: Role, watchers: set[Role] | frozenset[Role]) -> Traffic:
    return Traffic(key, Way.TOKEN, frozenset({holder}), frozenset(watchers))


TRAFFIC = (
    _put(JOBS.work("*"), {COORDINATOR}, {WORKER}, 4 * MIB),
    _put(JOBS.ctl("*"), {COORDINATOR}, {WORKER}, 256 * KIB),
    _put(JOBS.result(), {WORKER}, {COORDINATOR}, 4 * MIB),
    _put(JOBS.outcome(), {COORDINATOR}, {RECORDER}, 8 * MIB),
    _put(JOBS.recorded, {RECORDER}, {COORDINATOR}, 4 * KIB),
    _put(JOBS.stat("worker/*"), {WORKER}, {COORDINATOR}, 64 * KIB),
    _put(JOBS.stat("job"), {COORDINATOR}, set(), 256 * KIB),
    _put(JOBS.stat("run/*"), {COORDINATOR}, set(), 256 * KIB),
    _put(JOBS.stat("team/*"), {COORDINATOR}, set(), 256 * KIB),
    _put(JOBS.stat(), set(), WATCHERS, 256 * KIB),
    _put(JOBS.meta, {COORDINATOR}, WATCHERS, 256 * KIB),
    _put(JOBS.event(), {COORDINATOR}, WATCHERS, 16 * KIB),
    _query(JOBS.stat(), WATCHERS, {COORDINATOR}, 4 * KIB, MIB),
    _query(JOBS.meta, WATCHERS, {COORDINATOR}, 4 * KIB, MIB),
    _query(JOBS.recent, WATCHERS, {COORDINATOR}, 4 * KIB, MIB),
    _query(JOBS.entries, WATCHERS, {RECORDER}, 4 * KIB, MIB),
    _query(JOBS.finds, WATCHERS, {RECORDER}, 4 * KIB, 2 * MIB),
    _query(JOBS.recorded_asset(), WATCHERS, {RECORDER}, 4 * KIB, MIB),
    _query(JOBS.join, {WORKER}, {COORDINATOR}, 256 * KIB, 256 * KIB),
    _query(JOBS.control, {Role.ADMIN}, {COORDINATOR}, 4 * KIB, 16 * KIB),
    _query(JOBS.asset(), {WORKER, RECORDER}, {COORDINATOR}, 4 * KIB, MIB),
    _query(JOBS.open, {COORDINATOR}, {RECORDER}, MAX_PAYLOAD, 256 * KIB),
    _query(JOBS.log, {COORDINATOR}, {RECORDER}, 4 * KIB, 8 * MIB),
    _token(JOBS.coordinator_token(), COORDINATOR, {COORDINATOR, WORKER, Role.MONITOR}),
    _token(JOBS.worker_token(), WORKER, {COORDINATOR, Role.MONITOR}),
    _token(JOBS.recorder_token(), RECORDER, {COORDINATOR, Role.MONITOR}),
)
"""All traffic there is (docs/bus.md, keys)."""
