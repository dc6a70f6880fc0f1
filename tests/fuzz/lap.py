"""One lap of fuzzing: many changed messages, each given to a consumer of some kind."""

import resource
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.consumers import CONSUMERS, seeds
from tests.fuzz.mutator import Mutator

from qdgrasp_protocol.errors import QdgraspError

CORPUS = Path(__file__).parent / "corpus"
"""Bytes that were interesting once: by their file's name, KIND-WHAT.bin."""
SLOW = 2.0  # seconds that no message may take
ASTRAY = 0.1
"""The share of messages that are given to a consumer of another kind."""


@dataclass
class Lap:
    """What became of the messages.

    Attributes
    ----------
    taken
        How many were good messages still, by kind.
    refused
        How many were refused with an error of ours, by its kind.
    escaped
        Errors that are not ours, and the bytes that made them.
    slowest
        The longest that one took [s], in CPU time.
    growth
        How much the greatest memory of this process grew after the first tenth [bytes].
    """

    taken: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    escaped: list[tuple[str, bytes, str]] = field(default_factory=list)
    slowest: float = 0.0
    growth: int = 0

    @property
    def messages(self) -> int:
        """How many messages there were."""
        return self.taken.total() + self.refused.total() + len(self.escaped)

    def give(self, kind: str, payload: bytes) -> None:
        """Give a message to a consumer, and note what becomes of it."""
        began = time.process_time()
        try:
            CONSUMERS[kind](payload)
            self.taken[kind] += 1
        except QdgraspError as error:
            self.refused[type(error).__name__] += 1
            str(error).encode()
        except Exception:  # noqa: BLE001 - that none escapes is what is tested
            self.escaped.append((kind, payload, traceback.format_exc()))
        self.slowest = max(self.slowest, time.process_time() - began)


def corpus() -> dict[str, list[bytes]]:
    """The interesting bytes, by kind of message; those of kind `any` are for all."""
    found: dict[str, list[bytes]] = {kind: [] for kind in CONSUMERS}
    for path in sorted(CORPUS.glob("*.bin")):
        kind, payload = path.stem.partition("-")[0], path.read_bytes()
        for name in CONSUMERS if kind == "any" else [kind]:
            found[name].append(payload)
    return found


def run(messages: int, seed: int) -> Lap:
    """Give so many changed messages away."""
    known, start = corpus(), seeds()
    whole = [*start.values(), *(payload for payloads in known.values() for payload in payloads)]
    mutator, lap, early = Mutator(seed, whole), Lap(), 0
    kinds = list(CONSUMERS)
    for number in range(messages):
        kind = mutator.choose(kinds)
        begun = mutator.choose([start[kind]] * 3 + [mutator.choose(known[kind])])
        payload = mutator(begun)
        lap.give(kind if number % round(1 / ASTRAY) else mutator.choose(kinds), payload)
        if number == messages // 10:
            early = memory()
    lap.growth = memory() - early
    return lap


def memory() -> int:
    """The most memory that this process has had [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
