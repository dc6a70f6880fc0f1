"""All bytes that arrive give a message or an error of ours: no crash, no growth, no delay."""

import pytest
from tests.fuzz.consumers import CONSUMERS, seeds
from tests.fuzz.fuzzer import SLOW, FuzzResult, corpus, run

MESSAGES = 20_000
GROWTH = 64 << 20  # bytes; a message may have 16 MB


@pytest.mark.parametrize("kind", CONSUMERS)
def test_a_good_message_is_taken(kind: str) -> None:
    result = FuzzResult()
    result.give(kind, seeds()[kind])
    assert result.taken == {kind: 1}


def test_what_was_interesting_once_is_refused_or_taken_everywhere() -> None:
    result = FuzzResult()
    payloads = {payload for found in corpus().values() for payload in found}
    assert len(payloads) >= 20
    for payload in payloads:
        for kind in CONSUMERS:
            result.give(kind, payload)
    assert result.escaped == []
    assert result.slowest < SLOW


def test_twenty_thousand_changed_messages_are_refused_or_taken() -> None:
    result = run(MESSAGES, seed=0)
    assert result.messages == MESSAGES
    assert result.escaped == []
    assert result.slowest < SLOW
    assert result.growth < GROWTH
    assert set(result.taken) >= set(CONSUMERS), "changes that leave a message good are tried too"
    assert result.refused["MessageError"] > MESSAGES / 2
