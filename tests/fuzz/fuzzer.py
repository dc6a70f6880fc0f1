"""Changes messages at random, and gives many of them to consumers of some kind."""

import random
import resource
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgpack
from tests.fuzz.consumers import CONSUMERS, seeds

from qdgrasp_protocol.errors import QdgraspError

HEADS = [
    b"\xc0", b"\xc1", b"\xc4\xff", b"\xc5\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xc7\x00\x05",
    b"\xc9\xff\xff\xff\xff\x01", b"\xca\x7f\xc0\x00\x00", b"\xcb\x7f\xf0\x00\x00\x00\x00\x00\x00",
    b"\xcf" + b"\xff" * 8, b"\xd3\x80" + b"\x00" * 7, b"\xd6\xff\x00\x00\x00\x00", b"\xd9\xff",
    b"\xdb\xff\xff\xff\xff", b"\xdc\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xde\xff\xff",
    b"\xdf\xff\xff\xff\xff", b"\x80", b"\x90", b"\x9f", b"\xa0", b"\xff",
]  # fmt: skip
"""Beginnings of objects that say they are long, empty, strange or nothing at all."""
VALUES: list[Any] = [
    None, True, False, 0, 1, -1, 255, 4096, 4097, 2**31, 2**63 - 1, 2**63, 2**64 - 1, -(2**63), 0.0, -0.0,
    1e308, float("nan"), float("inf"), "", "x", "x" * 256, "x" * 257, "\x00", "²", "ü" * 100, "../..", b"",
    b"x", b"\xff" * 16, b"x" * 17, [], [[]], [0] * 17, [b""], {}, {"": ""}, {"v": 1},
    b"\x00\x00\xc0\x7f" * 8,
]  # fmt: skip
"""Values that a field may be said to have."""

DEEPER = 0.7
"""Share of lists and maps that are gone into and not changed as a whole."""


class Mutator:
    """Changes messages, by the same seed in the same ways; those in `corpus` are spliced with."""

    def __init__(self, seed: int, corpus: Sequence[bytes]) -> None:
        self._chance = random.Random(seed)  # noqa: S311 - to be the same again, not to be secret
        self.choose = self._chance.choice
        self._corpus = corpus
        self._ways: list[Callable[[bytearray], bytes]] = [
            self._flip, self._set, self._cut, self._insert, self._splice,
            self._value, self._value, self._value,
        ]  # fmt: skip

    def __call__(self, message: bytes) -> bytes:
        """A message that is changed in one to four ways."""
        for _ in range(self._chance.choice((1, 1, 2, 4))):
            message = self._chance.choice(self._ways)(bytearray(message))
        return bytes(message)

    def _place(self, message: bytearray) -> int:
        """Near the beginning, where the structure is, more often than not."""
        most = min(len(message), 200) if self._chance.random() < 0.7 else len(message)
        return self._chance.randint(0, most)

    def _flip(self, message: bytearray) -> bytes:
        if message:
            message[self._chance.randrange(len(message))] ^= 1 << self._chance.randrange(8)
        return bytes(message)

    def _set(self, message: bytearray) -> bytes:
        if message:
            message[min(self._place(message), len(message) - 1)] = self._chance.randrange(256)
        return bytes(message)

    def _cut(self, message: bytearray) -> bytes:
        return bytes(message[: self._place(message)])

    def _insert(self, message: bytearray) -> bytes:
        at = self._place(message)
        return bytes(message[:at] + self._chance.choice(HEADS) + message[at:])

    def _splice(self, message: bytearray) -> bytes:
        other = self._chance.choice(self._corpus)
        return bytes(message[: self._place(message)]) + other[self._place(bytearray(other)) :]

    def _value(self, message: bytearray) -> bytes:
        """Change one value of a map, or in what it holds, and pack it again."""
        try:
            values = msgpack.unpackb(bytes(message), max_array_len=5000, max_map_len=64)
        except (ValueError, msgpack.UnpackException):
            return self._flip(message)
        holder = values
        while isinstance(holder, dict | list) and holder:
            key = self._chance.choice(list(holder if isinstance(holder, dict) else range(len(holder))))
            if not (isinstance(holder[key], dict | list) and holder[key] and self._chance.random() < DEEPER):
                self._change(holder, key)
                break
            holder = holder[key]
        return bytes(msgpack.packb(values))

    def _change(self, holder: Any, key: Any) -> None:
        """Replace, take out, or rename a value."""
        match self._chance.randrange(6):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, dict):
                holder[self._chance.choice(("", "more", str(key) + "x"))] = holder.pop(key)
            case 2 if isinstance(holder[key], bytes | str) and holder[key]:
                holder[key] = holder[key][: self._chance.randrange(len(holder[key]))]
            case 3 if isinstance(holder[key], int) and not isinstance(holder[key], bool):
                changed = holder[key] + self._chance.choice((-1, 1, 1 << 20))
                holder[key] = max(-(2**63), min(2**64 - 1, changed))
            case _:
                holder[key] = self._chance.choice(VALUES)


CORPUS = Path(__file__).parent / "corpus"
"""Bytes that were interesting once: by their file's name, KIND-WHAT.bin."""
SLOW = 2.0  # seconds that no message may take
OTHER_CONSUMER_SHARE = 0.1
"""The share of messages that are given to a consumer of another kind."""


@dataclass
class FuzzResult:
    """Results of giving messages to consumers."""

    taken: Counter[str] = field(default_factory=Counter)  # those that were good still, by kind
    refused: Counter[str] = field(default_factory=Counter)  # those refused with an error of ours, by its kind
    escaped: list[tuple[str, bytes, str]] = field(default_factory=list)  # errors that are not ours
    slowest: float = 0.0  # the longest that one took [s], in CPU time
    growth: int = 0  # of the greatest memory of this process after the first tenth [bytes]

    @property
    def messages(self) -> int:
        return self.taken.total() + self.refused.total() + len(self.escaped)

    def give(self, kind: str, payload: bytes) -> None:
        """Give a message to a consumer, and note the result."""
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


def run(messages: int, seed: int) -> FuzzResult:
    """Give so many changed messages away."""
    known, start = corpus(), seeds()
    whole = [*start.values(), *(payload for payloads in known.values() for payload in payloads)]
    mutator, result, early = Mutator(seed, whole), FuzzResult(), 0
    kinds = list(CONSUMERS)
    for number in range(messages):
        kind = mutator.choose(kinds)
        begun = mutator.choose([start[kind]] * 3 + [mutator.choose(known[kind])])
        payload = mutator(begun)
        result.give(kind if number % round(1 / OTHER_CONSUMER_SHARE) else mutator.choose(kinds), payload)
        if number == messages // 10:
            early = memory()
    result.growth = memory() - early
    return result


def memory() -> int:
    """The most memory that this process has had [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
