"""Runs made by hand, in folders, with their rows and scenes."""

import sqlite3
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import Bundle, Scene, pack_scene
from qdgrasp_coordinator.storage.journal import JournalIdentity, JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import COLUMNS, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

SHAPE = RowShape(genes=2, joints=2)


def random_rows(n: int, seed: int = 0, reach: float = 0.1) -> Rows:
    """Nominal rows of all outcomes around the object, in journal order, ten to a generation."""
    random = np.random.default_rng(seed)
    rows = SHAPE.empty(n)
    rows["generation"], rows["index"] = np.divmod(np.arange(n), 10)
    rows["outcome"] = random.integers(Outcome.OVERLAP, Outcome.HELD, n, endpoint=True)
    rows["fitness"] = np.clip(rows["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    rows["base_to_object"][:, :3] = random.uniform(-reach, reach, (n, 3))
    rows["base_to_object"][:, 6] = 1
    rows["descriptor"] = rows["base_to_object"][:, :3]
    rows["nu"], rows["surface_point"] = random.uniform(0, np.pi, n), 0.01
    return rows


def reshape_rows(rows: Rows, shape: RowShape) -> Rows:
    """Return the rows in a shape that is wider, zeros behind genes, or narrower."""
    if rows.dtype == shape.dtype:
        return rows
    made = shape.empty(len(rows))
    for column in COLUMNS:
        source, target = rows[column.name], made[column.name]
        common = tuple(map(slice, np.minimum(source.shape, target.shape)))
        target[common] = source[common]
    return made


def spoil_block(journal: Path, first: int) -> None:
    """Change one bit in the middle of the block that begins with a row."""
    with sqlite3.connect(journal) as database:
        ((blob,),) = database.execute("SELECT rows FROM blocks WHERE first = ?", (first,))
        spoilt = bytearray(blob)
        spoilt[len(blob) // 2] ^= 1
        database.execute("UPDATE blocks SET rows = ? WHERE first = ?", (spoilt, first))


def record(path: Path, scene: Scene, rows: Rows, /, **settings: Any) -> RunFolder:
    """A run's folder with these rows; `settings` are those of its spec."""
    bundle = pack_scene(msgspec.structs.replace(scene, protocol=settings.get("protocol", "paper")))
    spec = RunSpec(**{"gripper": "jaw", "object": "block.stl", "mass": 0.1, "population": 10} | settings)
    return record_spec(path, spec, rows, bundle)


def record_spec(
    path: Path, spec: RunSpec, rows: Rows, bundle: Bundle | None = None, block: int = 1 << 20
) -> RunFolder:
    """A run's folder with these rows, recorded in blocks of so many; it may have no scene yet."""
    folder = RunFolder.create(path, spec, bundle)
    write_journal(path, spec, rows, bundle, block)
    return folder


def write_journal(
    path: Path, spec: RunSpec, rows: Rows, bundle: Bundle | None, block: int = 1 << 20, run: str = "run"
) -> None:
    """Record rows in the folder of a run that was begun."""
    shape = RowShape(*(rows.dtype[name].shape[0] for name in ("genome", "joints", "contact_links")))
    identity = JournalIdentity(run, spec, bundle.digest if bundle else "0" * 64, shape)
    with JournalWriter.create(path, identity) as journal:
        journal.begin_epoch(1, 0.0)
        for first in range(0, len(rows), block):
            part = rows[first : first + block]
            journal.append(JournalSlice(first, part, cpu_seconds=len(part) / 100), 1, 1.0)


def success_mask(rows: Rows) -> NDArray[np.bool_]:
    """Flag the nominal successes, which archives, coverage and figures count: (n,)."""
    found: NDArray[np.bool_] = (rows["trial"] == 0) & (rows["outcome"] >= Outcome.DROPPED)
    return found
