"""Merges the successes of runs of one scene, and prunes the failures of finished runs."""

import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.niches import NicheArchive, synergies
from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_coordinator.metrics.success_metrics import SuccessMetrics, diversity
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.engine_table import TABLES, read_table, renumber, to_csv
from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder, JobRecord
from qdgrasp_coordinator.storage.journal_schema import JournalIdentity, explaining_read_errors
from qdgrasp_coordinator.storage.journal_writer import explaining_write_errors
from qdgrasp_coordinator.storage.outputs import JOURNAL, LOGS
from qdgrasp_coordinator.storage.run_folder import RunFolder, run_files
from qdgrasp_protocol.errors import FolderError, InputError
from qdgrasp_protocol.rows import trial_count
from qdgrasp_protocol.spec import GOAL_KEYS, RunSpec, to_toml
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.campaign_folder import SCENE_KEYS
from qdgrasp_tools.campaign.ranking import is_reranking
from qdgrasp_tools.campaign.reduced_journal import (
    MergePart,
    common_shape,
    is_kept,
    journal_sources,
    merge_parts,
    source_rows,
    write_reduced_journal,
)
from qdgrasp_tools.campaign.summary import RunSummary, run_summary

SUMMED_FIELDS = (
    "evaluations", "budget", "rows", "trials", "simulated", "proposals", "overlaps", "dead_ends",
    "successes", "grasps", "robust", "errors", "checked", "differing", "cpu_seconds", "wall_seconds",
)  # fmt: skip
"""Figures that are the sums of those of the sources; the others are counted anew."""
MOST_EVALUATIONS = 10**9


@dataclass(frozen=True)
class MergeResult:
    """Result of merging runs."""

    summary: RunSummary
    repeats: tuple[str, ...]
    """One sentence for each run left out because another one has all its rows."""


def merge_runs(folders: Sequence[RunFolder], out: Path) -> MergeResult:
    """Join the successes of runs of one scene in a new folder, that appears whole or not at all.

    Raises FolderError or DiskFull if a folder cannot be read, or `out` holds something or cannot be written,
    and InputError if the runs are of different scenes, or one under a protocol with trials is not finished.
    """
    RunFolder.check_free(out)
    parts, repeats = merge_parts(folders)
    for part in parts:
        _check_same_scene(parts[0], part)
        if trial_count(part.source.asked.protocol) and not part.source.summary["complete"]:
            raise InputError(
                f"{part.folder.path} is not finished, so that successes lack their trials: "
                f"`qdgrasp resume {part.folder.path}` goes on with it."
            )
    shape, found = common_shape([part.folder for part in parts]), _merged_summary(parts)
    identity = JournalIdentity(RUN, to_toml(_merged_spec(parts)), parts[0].source.scene, shape)
    atomic_files.create_folder(
        out,
        JobRecord.begun(out, None).file | run_files(_merged_spec(parts), parts[0].folder.bundle()),
        folders=[LOGS],
        fill=lambda made: write_reduced_journal(
            made / JOURNAL, identity, found, ((part.source, part.rows(shape)) for part in parts)
        ),
    )
    return MergeResult(found, repeats)


def _check_same_scene(one: MergePart, other: MergePart) -> None:
    if one.source.scene == other.source.scene:
        return
    specs = one.source.asked, other.source.asked
    values = [(key, *(getattr(spec, key) for spec in specs)) for key in SCENE_KEYS]
    differ = [f"{key} ({mine} and {its})" for key, mine, its in values if mine != its]
    why = ", ".join(differ) or "the scene's files or the version of qdgrasp that read them"
    raise InputError(
        f"{one.folder.path} and {other.folder.path} are of different scenes, which are not merged: they "
        f"differ in {why}."
    )


def _merged_spec(parts: Sequence[MergePart]) -> RunSpec:
    budget = min(sum(part.source.asked.evaluations for part in parts), MOST_EVALUATIONS)
    first = max((part.source.asked for part in parts), key=lambda asked: len(asked.stages))
    none = dict.fromkeys(("finalists", *GOAL_KEYS, "poses"))
    return msgspec.structs.replace(first, evaluations=budget, **none)


def _merged_summary(parts: Sequence[MergePart]) -> RunSummary:
    summaries = [part.source.summary for part in parts]
    platforms = [part.source.platform.items() for part in parts]
    values: dict[str, Any] = dict(summaries[0])
    values.pop("in_both", None)  # the merged folder has no table of another engine
    values |= {name: sum(one.get(name, 0) for one in summaries) for name in SUMMED_FIELDS}
    if len({one.get("grasps_per_cell") for one in summaries}) > 1:
        values["grasps_per_cell"] = None
    for name in ("method", "aim_for", "told_apart_by", "overlaps_mode"):
        values[name] = ", ".join(sorted({one.get(name, "") for one in summaries} - {""}))
    values |= {
        "complete": all(one["complete"] for one in summaries),
        "ended": f"merged from {counted(len(parts), 'run')}",
        "platform": dict(item for item in platforms[0] if all(item in other for other in platforms)),
        "reduced": "failures: only the successes of the merged runs are kept",
        "sources": [part.source.words for part in parts],
    }
    return msgspec.convert(values | _shared_figures(parts, values), RunSummary)


def _shared_figures(parts: Sequence[MergePart], sums: dict[str, Any]) -> dict[str, Any]:
    """Count the figures that depend on the cells and niches that several runs share."""
    scene = parts[0].folder.scene()
    reached, metrics = set[int](), SuccessMetrics(TrialPlan.of(_merged_spec(parts)))
    archives = []
    for part in parts:
        archive = NicheArchive(synergies(scene, prior_of(part.source.asked)))
        for rows in archive.inserting(source_rows(part.folder, part.number)):
            metrics.count(rows)
            reached.update(cell_keys(cells(successes(rows)["descriptor"][:, :3])).tolist())
        archives.append(archive)
    done = sums["evaluations"]
    return {
        "cells": len(reached),
        "diversity": msgspec.to_builtins(diversity(reduce(NicheArchive.joined, archives))),
        "qd_score": metrics.qd_score,
        "success_share": sums["successes"] / done if done else None,
        "mean_fitness": metrics.mean_fitness,
        "nu": msgspec.to_builtins(metrics.nu),
        "eta": msgspec.to_builtins(metrics.eta),
    }


PARTIAL_FILE = f"{JOURNAL}.part"
SETTLE_TIMEOUT = 1.0  # seconds; a reader of a run has its journal open for an instant
SETTLE_INTERVAL = 0.05  # seconds between two tries
PRIMARY_CODE = 0xFF  # The bits of SQLite's error codes that say what went wrong; those above say more of how


def prune_run(folder: RunFolder) -> int:
    """Drop the failures of a finished run; returns the bytes that this freed.

    The journal is replaced as a whole, or left as it was; readers are waited for a little, and those that
    begin after that read the old one. Tables of other engines get the new numbers of their rows. Raises
    InputError if such a table is damaged, and FolderError or DiskFull if the run is not finished, was pruned
    before, is in use or being read, ranks poses by all of their trials, or its folder cannot be written.
    """
    with folder.job.supervise(), folder.job.lock():
        return _prune_locked(folder)


@dataclass(frozen=True)
class PruneResult:
    """Result of pruning a campaign."""

    freed: int
    """Bytes that were freed."""
    pruned: int
    """Runs that keep successes alone now, also those that did before."""
    runs: int


def prune_campaign(job: JobFolder) -> PruneResult:
    """Drop the failures of a campaign's finished runs; raises as `prune_run`."""
    freed, pruned = 0, 0
    with job.supervise(), job.lock():
        folders = [RunFolder(path) for path in job.run_paths if RunFolder.is_run(path)]
        for folder in folders:
            with folder.journal() as journal:
                is_reduced = bool(journal.sources)
            if not is_reduced and not run_summary(folder).complete:
                continue
            freed, pruned = freed + (0 if is_reduced else _prune_locked(folder)), pruned + 1
    return PruneResult(freed, pruned, len(folders))


def _prune_locked(folder: RunFolder) -> int:
    """Prune a run whose job's locks are held, as `prune_run` does."""
    with folder.journal() as journal:
        journal.check_whole()
        shape, run = journal.shape, journal.run
    (source,) = journal_sources(folder)
    if not source.summary["complete"]:
        raise FolderError(f"{folder.path} is not finished: what is pruned cannot be gone on with.")
    if is_reranking(folder):
        raise FolderError(f"{folder.path} ranks poses, for which every row is needed.")
    identity = JournalIdentity(run, source.spec, source.scene, shape)
    found = msgspec.structs.replace(
        msgspec.convert(source.summary, RunSummary), reduced="failures: only successes are kept"
    )
    file, part = folder.path / JOURNAL, folder.path / PARTIAL_FILE
    tables = _renumbered_tables(folder)
    before = file.stat().st_size
    try:
        _checkpoint_journal(file)
        write_reduced_journal(part, identity, found, [(source, source_rows(folder, 0))])
        with atomic_files.writing(folder.path):
            for table, payload in tables.items():
                atomic_files.write_through(table, payload)
            _replace_journal(part, list(tables))
    finally:
        for left in (part, *tables):
            left.unlink(missing_ok=True)
    return before - file.stat().st_size


def _replace_journal(part: Path, tables: list[Path]) -> None:
    """Put a journal and tables in the place of the old ones, or leave all as it was.

    A process that is killed leaves no table beside rows of other numbers.
    """
    old = {table.with_suffix(""): table.with_suffix("").read_bytes() for table in tables}
    try:
        for table in old:
            table.unlink()
        atomic_files.sync(part.parent)
        part.replace(part.with_suffix(""))
        atomic_files.sync(part.parent)
    except BaseException:
        for table, payload in old.items() if part.exists() else ():
            atomic_files.write_through(table, payload)
        raise
    finally:
        for made in tables if not part.exists() else ():
            made.replace(made.with_suffix(""))
    atomic_files.sync(part.parent)


def _renumbered_tables(folder: RunFolder) -> dict[Path, bytes]:
    """Return the tables of other engines with the numbers of the pruned journal, by new file."""
    with folder.journal() as journal:
        numbers = [part.first + np.flatnonzero(is_kept(part.rows)) for part in journal.slices()]
    kept = np.concatenate([np.zeros(0, np.int64), *numbers])
    tables = {path: renumber(read_table(path), kept) for path in folder.path.glob(TABLES)}
    return {path.with_name(f"{path.name}.part"): to_csv(table) for path, table in tables.items()}


def _checkpoint_journal(file: Path) -> None:
    """Move all of a journal into its one file, so that another may take its place.

    Raises FolderError if it is being read, and that does not end soon.
    """
    deadline = time.monotonic() + SETTLE_TIMEOUT
    while not _is_checkpointed(file):
        if time.monotonic() > deadline:
            raise FolderError(
                f"{file} is being read by another process; nothing was changed: prune it when that is done."
            )
        time.sleep(SETTLE_INTERVAL)  # SQLite itself does not wait here


def _is_checkpointed(file: Path) -> bool:
    """Checkpoint the file; return False where another process has it open."""
    with (
        explaining_read_errors(file),
        explaining_write_errors(file.parent),
        closing(sqlite3.connect(file)) as database,
    ):
        try:
            database.execute("PRAGMA journal_mode = DELETE")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & PRIMARY_CODE != sqlite3.SQLITE_BUSY:
                raise
            return False
    return True
