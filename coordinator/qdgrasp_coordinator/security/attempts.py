"""Everybody tries everything at a running router; what arrives is noted.

What is allowed must arrive, and that it does shows that the router has dealt with what was tried before it
on the same link. Then a quiet while must pass in which nothing else arrives.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress

from qdgrasp_coordinator.security.meetings import Meeting, Notes, allowed
from qdgrasp_coordinator.security.stage import ACTORS, KEYS, WIDE, Stage, Taker
from qdgrasp_coordinator.security.traffic import Way
from qdgrasp_protocol.bus import Bus, Query, QueryHandler, Sample, SampleHandler, TokenHandler
from qdgrasp_protocol.errors import NoReply, Refused

ENCODING = "text/plain"
PATIENCE = 10.0  # seconds that anything may take that is to happen
ROUND = 0.2  # seconds between two tries: declarations may still be on their way
QUIET = 0.5  # seconds in which nothing is to happen
ASK = 1.0  # seconds that an answer may take


def puts(stage: Stage) -> set[Meeting]:
    """All publish on all keys while all subscribe to all of them: who heard whom."""
    heard, due = Notes(), allowed(Way.PUT, KEYS)
    with ExitStack() as stack:
        for taker in stage.takers:
            for pattern in taker.patterns:
                stack.enter_context(taker.bus.subscribe(pattern, _hearer(taker, heard)))
        for _ in _rounds(heard, due):
            for giver, bus in stage.givers.items():
                for key in (*WIDE, *KEYS):
                    bus.put(key, giver.encode(), encoding=ENCODING)
    return heard.seen


def queries(stage: Stage) -> set[Meeting]:
    """All ask all keys while one after the other answers on all of them: who was answered by whom.

    What is allowed counts when the question and the answer arrived, anything else when one of them did.
    """
    asked, answered, due = Notes(), Notes(), allowed(Way.QUERY, KEYS)
    for taker in stage.takers:
        with ExitStack() as stack:
            for pattern in taker.patterns:
                stack.enter_context(taker.bus.answer(pattern, _answerer(taker, asked)))
            for _ in _rounds(answered, {meeting for meeting in due if meeting.taker == taker.name}):
                for giver, bus in stage.givers.items():
                    _ask(giver, bus, answered)
    both, any_ = asked.seen & answered.seen, asked.seen | answered.seen
    return both | (any_ - due)


def tokens(stage: Stage) -> set[Meeting]:
    """One after the other is alive on all keys while all watch them: who saw whom."""
    found = set()
    for giver, bus in stage.givers.items():
        seen, due = Notes(), {meeting for meeting in allowed(Way.TOKEN, KEYS) if meeting.giver == giver}
        with ExitStack() as stack:
            for key in KEYS:
                stack.enter_context(bus.token(key))
            for taker in stage.takers:
                for pattern in taker.patterns:
                    stack.enter_context(taker.bus.watch(pattern, _watcher(giver, taker, seen)))
            seen.wait(due, PATIENCE)
            time.sleep(QUIET)
        time.sleep(QUIET)  # until nobody sees these tokens any more
        found |= seen.seen
    return found


ATTEMPTS = {Way.PUT: puts, Way.QUERY: queries, Way.TOKEN: tokens}


def _rounds(notes: Notes, due: set[Meeting]) -> Iterator[None]:
    """Rounds of tries: until everything that is due was seen, and once more; and a quiet while after it."""
    deadline = time.monotonic() + PATIENCE
    yield
    while not notes.wait(due, ROUND) and time.monotonic() < deadline:
        yield
    yield
    time.sleep(QUIET)


def _ask(giver: str, bus: Bus, answered: Notes) -> None:
    """Ask every key once."""
    for key in (*WIDE, *KEYS):
        with suppress(NoReply, Refused):
            taker = bus.ask(key, giver.encode(), timeout=ASK).decode(errors="replace")
            answered.add(Meeting(Way.QUERY, key, giver, taker))


def _hearer(taker: Taker, heard: Notes) -> SampleHandler:
    def hear(sample: Sample) -> None:
        giver = sample.payload.decode(errors="replace")
        if giver in ACTORS:
            heard.add(Meeting(Way.PUT, sample.key, giver, taker.name))

    return hear


def _answerer(taker: Taker, asked: Notes) -> QueryHandler:
    def answer(query: Query) -> bytes:
        giver = query.payload.decode(errors="replace")
        if giver not in ACTORS:
            raise NoReply("not a question of this check")
        asked.add(Meeting(Way.QUERY, query.key, giver, taker.name))
        return taker.name.encode()

    return answer


def _watcher(giver: str, taker: Taker, seen: Notes) -> TokenHandler:
    def watch(key: str, alive: bool) -> None:
        if alive and key in KEYS:
            seen.add(Meeting(Way.TOKEN, key, giver, taker.name))

    return watch
