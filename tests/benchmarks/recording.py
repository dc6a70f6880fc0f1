"""Rows that a recorder makes durable in a second of the clock on the wall, the bus apart."""

import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from math import inf
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from tests.benchmarks.measure import Figure, Meter, Subject, in_turns

from qdgrasp_coordinator.counts.stretch import Stretch, to_message
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.folders.journal_writer import JournalWriter
from qdgrasp_coordinator.recording.books import Books
from qdgrasp_protocol.messages import Open, OpenRun
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import RunSpec, to_toml

SHAPE = Shape(genes=7, joints=2)
GROUPS = (100, 2000)
"""Rows in a transaction."""
RUNS = (1, 20)
"""Runs whose rows arrive in turns."""
SLICE = 100
"""Rows in a message."""
MESSAGES = 41
"""Messages of each run until everything is committed: two full groups."""


def measure(seconds: float) -> list[Figure]:
    with ExitStack() as stack:
        alone = [Alone(_folder(stack), group) for group in GROUPS]
        turns = [Turns(stack, runs) for runs in RUNS]
        for writer in alone:
            stack.callback(writer.close)
        subjects = [Subject(f"recorder, {work.group} rows at a time", work, "wall") for work in alone]
        subjects += [Subject(f"recorder, runs in turns: {len(work.names)}", work, "wall") for work in turns]
        return in_turns(subjects, seconds / 2)


def _folder(stack: ExitStack) -> Path:
    return Path(stack.enter_context(tempfile.TemporaryDirectory(dir=Path.cwd())))


class Alone:
    """A journal, a transaction at a time."""

    remark = "wall time; a transaction each, synced to the disk of this folder"
    stages: Mapping[str, float] = {}

    def __init__(self, folder: Path, group: int) -> None:
        self.group = group
        self._rows = _rows(group)
        self._done = 0
        self._writer = JournalWriter.create(folder, Identity("run", "", "", SHAPE))
        self._writer.begin_turn(1, time.time())

    def close(self) -> None:
        self._writer.close()

    def __call__(self, meter: Meter) -> float:
        with meter.running():
            self._writer.append(Stretch(self._done, self._rows), 1, time.time())
        self._done += self.group
        return self.group


class Turns:
    """Runs whose rows arrive in turns, committed in groups."""

    remark = f"wall time; {SLICE} rows in a message, committed in groups"
    stages: Mapping[str, float] = {}

    def __init__(self, stack: ExitStack, runs: int) -> None:
        self.names = [f"run-{number}" for number in range(runs)]
        self._books = stack.enter_context(Books(_folder(stack) / "job", "job"))
        self._books.open(_opening(self.names))
        self._message = to_message(Stretch(0, _rows(SLICE)), "", self._books.epoch, SHAPE)
        self._done = 0

    def __call__(self, meter: Meter) -> float:
        """Take so many messages that most groups are complete, and commit what is left."""
        with meter.running():
            for _ in range(MESSAGES):
                for name in self.names:
                    self._books.take(replace(self._message, run=name, first=self._done), time.monotonic())
                    _commit(self._books, time.monotonic())
                self._done += SLICE
            _commit(self._books, inf)
        return MESSAGES * SLICE * len(self.names)


def _opening(names: list[str]) -> Open:
    spec = to_toml(RunSpec(gripper="panda", object="mug")).encode()
    widths = {"genes": SHAPE.genes, "joints": SHAPE.joints, "descriptors": SHAPE.descriptors}
    return Open(job="job", runs=[OpenRun(run=name, spec=spec, scene="0" * 64, **widths) for name in names])


def _commit(books: Books, now: float) -> None:
    for run in books.due(now):
        books.commit(run)


def _rows(n: int) -> Rows:
    random = np.random.default_rng(0)
    rows = SHAPE.empty(n)
    rows["outcome"] = random.choice([Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD], n, p=[0.6, 0.25, 0.15])
    rows["descriptor"] = random.uniform(-0.2, 0.2, (n, 3))
    return rows
