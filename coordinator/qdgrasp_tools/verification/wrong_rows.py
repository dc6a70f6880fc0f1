"""Takes rows of a run back, so that `qdgrasp resume` evaluates them again.

A search has learned from every row, so that all rows behind one that is taken back go with it. What was there
stays in the journal's table `withdrawn`.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.platforms import is_of_gpu
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.text import counted
from qdgrasp_tools.local.progress import ProgressDisplay
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.verification.comparison import DifferentRow, VerificationReport
from qdgrasp_tools.verification.verify import select_rows, verify_rows


def take_rows_back(folder: RunFolder, first: int) -> int:
    """Take back the block of row `first` and all behind it; returns how many rows went."""
    with folder.job.lock(), JournalWriter.open(folder.path) as journal:
        return journal.count - journal.withdraw(first)


def take_errors_back(folder: RunFolder) -> None:
    """Take back the first row of a run on which the simulator failed, and all behind it."""
    with folder.journal() as journal:
        errors = journal.errors()
    if errors:
        take_rows_back(folder, min(errors))


def take_wrong_rows_back(
    found: VerificationReport, config: LocalJobConfig, display: ProgressDisplay, stop: Stop
) -> list[str]:
    """Take back the first wrong row of each run in which rows differ, and all behind it.

    Rows before it that the makers of differing rows made too are evaluated again, or all where a maker is not
    known; a row is wrong that differs in the same way a second time. Returns a sentence for each run, or one
    if rows were made on another platform than this one, where other bits are no fault.
    """
    if any(one.differences or not one.platform or is_of_gpu(one.platform) for one in found.origins):
        return ["No row is taken back: on the platform that they were made on these bits may be right."]

    def again(folder: RunFolder, rows: Sequence[int]) -> list[DifferentRow]:
        return verify_rows(select_rows(folder, rows), config, display, stop).different if rows else []

    said = []
    for path in dict.fromkeys(row.folder for row in found.different):
        folder = RunFolder(Path(path))
        differ = {row.number: row for row in found.different if row.folder == path}
        differ |= {row.number: row for row in again(folder, suspect_rows(folder, differ))}
        differing = again(folder, sorted(differ))
        if stop.is_set:
            break
        if wrong := [row.number for row in differing if row == differ[row.number]]:
            rows, command = counted(take_rows_back(folder, min(wrong)), "row"), folder.job.resume_command
            said.append(f"{rows} of {path} are taken back; `{command}` evaluates them again.")
        else:
            said.append(f"No row of {path} is taken back: none differs in the same way a second time.")
    return said


def suspect_rows(folder: RunFolder, differ: Iterable[int]) -> list[int]:
    """Return the rows before the first of those that differ whose makers made one of these too."""
    first = min(differ)
    with folder.journal() as journal:
        makers = np.zeros(journal.count, dtype="U64")
        for start, n, worker, _ in journal.makers():
            makers[start : start + n] = worker
    blamed = makers[list(differ)]
    if not blamed.all():
        return list(range(first))
    return np.flatnonzero(np.isin(makers[:first], blamed)).tolist()
