"""Rows that a recorder makes durable in a second of the clock on the wall, the bus apart."""

import tempfile
import time
from math import inf
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from tests.benchmarks.measure import Figure

from qdgrasp_coordinator.books import Books
from qdgrasp_coordinator.journal_format import Identity
from qdgrasp_coordinator.journal_writer import JournalWriter
from qdgrasp_coordinator.stretch import Stretch, to_message
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


def measure(seconds: float) -> list[Figure]:
    alone = [_recorder(group, seconds / 3) for group in GROUPS]
    return alone + [_interleaved(runs, seconds / 3) for runs in RUNS]


def _recorder(group: int, seconds: float) -> Figure:
    rows = _rows(group)
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        writer = JournalWriter.create(Path(folder), Identity("run", "", "", SHAPE))
        writer.begin_turn(1, time.time())
        began, done = time.perf_counter(), 0
        while time.perf_counter() - began < seconds:
            writer.append(Stretch(done, rows), 1, time.time())
            done += group
        passed = time.perf_counter() - began
        writer.close()
    remark = "wall time; a transaction each, synced to the disk of this folder"
    return Figure(f"recorder, {group} rows at a time", done, passed, "wall", remark)


def _interleaved(runs: int, seconds: float) -> Figure:
    names = [f"run-{number}" for number in range(runs)]
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder, Books(Path(folder) / "job", "job") as books:
        books.open(_opening(names))
        message = to_message(Stretch(0, _rows(SLICE)), "", books.epoch, SHAPE)
        began, done = time.perf_counter(), 0
        while time.perf_counter() - began < seconds:
            for name in names:
                books.take(replace(message, run=name, first=done), time.monotonic())
                _commit(books, time.monotonic())
            done += SLICE
        _commit(books, inf)
        passed = time.perf_counter() - began
    remark = f"wall time; {SLICE} rows in a message, committed in groups"
    return Figure(f"recorder, runs in turns: {runs}", done * runs, passed, "wall", remark)


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
