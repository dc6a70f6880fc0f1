"""Rows that a recorder makes durable in a second of the clock on the wall, the bus apart."""

import tempfile
import time
from pathlib import Path

import numpy as np
from tests.benchmarks.measure import Figure

from qdgrasp_coordinator.journal_format import Identity
from qdgrasp_coordinator.journal_writer import JournalWriter
from qdgrasp_coordinator.stretch import Stretch
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

SHAPE = Shape(genes=7, joints=2)
GROUPS = (100, 2000)
"""Rows in a transaction."""


def measure(seconds: float) -> list[Figure]:
    return [_recorder(group, seconds / 3) for group in GROUPS]


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


def _rows(n: int) -> Rows:
    random = np.random.default_rng(0)
    rows = SHAPE.empty(n)
    rows["outcome"] = random.choice([Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD], n, p=[0.6, 0.25, 0.15])
    rows["descriptor"] = random.uniform(-0.2, 0.2, (n, 3))
    return rows
