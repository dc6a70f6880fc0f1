"""Prepared results: bytes that answer a batch at once, with rows of a plausible mix of outcomes."""

from collections.abc import Iterator
from itertools import cycle

import msgpack
import numpy as np

from qdgrasp_protocol import codec
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Rows, Shape, pack

SHAPE = Shape(genes=7, joints=2)
"""The rows of a two-finger hand."""
REACH = 0.15
"""Hands are anywhere in a cube of twice that [m]."""
VARIETY = 64
"""Different results for batches of one length."""
_MARKS = {"generation": 2**62 + 1, "batch": b"\xa5" * 16, "attempt": 2**62 + 3}
"""What stands in a result where a batch's own values are filled in."""


def rows(n: int, random: np.random.Generator, shape: Shape = SHAPE) -> Rows:
    """Results as of random poses: three of five overlap, one of seven succeeds."""
    found = shape.empty(n)
    found["outcome"] = random.choice([Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD], n, p=[0.6, 0.25, 0.15])
    found["fitness"] = np.maximum(found["outcome"].astype(int) - Outcome.DROPPED, 0)
    found["proposals"] = 1
    for column in ("descriptor", "base_to_object", "joints", "surface_point"):
        found[column] = random.uniform(-REACH, REACH, found[column].shape)
    return found


class Answers:
    """The prepared results of one worker to the batches of one run.

    Parameters
    ----------
    number
        The worker's: each has results of its own.
    seconds
        What a batch is said to cost [CPU s].
    """

    def __init__(self, number: int, wid: str, epoch: int, run: str, n: int, seconds: float) -> None:
        random = np.random.default_rng((number, n))
        self._pieces: Iterator[list[bytes]] = cycle(
            [_cut(_result(wid, epoch, run, rows(n, random), seconds)) for _ in range(VARIETY)]
        )

    def to(self, generation: int, batch: bytes, attempt: int) -> bytes:
        """The next one, for a batch."""
        first, second, third, rest = next(self._pieces)
        return b"".join(
            (first, msgpack.packb(generation), second, batch, third, msgpack.packb(attempt), rest)
        )


def _result(wid: str, epoch: int, run: str, found: Rows, seconds: float) -> bytes:
    return codec.encode(
        Result(
            epoch=epoch,
            run=run,
            wid=wid,
            n=len(found),
            joints=SHAPE.joints,
            descriptors=SHAPE.descriptors,
            columns=pack(found, RESULT),
            cpu_seconds=seconds,
            **_MARKS,
        )
    )


def _cut(payload: bytes) -> list[bytes]:
    """A result in front of, between and behind its marks."""
    pieces = []
    for mark in _MARKS.values():
        packed = mark if isinstance(mark, bytes) else msgpack.packb(mark)
        before, found, payload = payload.partition(packed)
        assert found
        pieces.append(before)
    return [*pieces, payload]
