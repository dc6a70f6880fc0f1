"""Finds a recorded row with its scene, and has a worker's process replay its evaluation."""

import json
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import Provenance, RunFolder, provenance
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.process import ProcessExit, ProcessSupervisor, Stop
from qdgrasp_protocol.replay_messages import (
    ANSWER,
    REQUEST,
    SCENE,
    ReplayAnswer,
    ReplayRequest,
)
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.local.supervisor import GRACE
from qdgrasp_tools.report.row_report import row_at


@dataclass(frozen=True)
class ReplayTarget:
    """A recorded row to replay, with its run and scene."""

    number: int
    row: np.void
    """The row in the shape of its own run."""
    found_by: Provenance
    scene: Scene
    bundle: Bundle

    @property
    def outcome(self) -> Outcome:
        """Outcome of its evaluation."""
        return Outcome(self.row["outcome"])

    @property
    def trial(self) -> int:
        """Number of the trial; 0: the nominal evaluation."""
        return int(self.row["trial"])

    @property
    def genome(self) -> tuple[float, ...]:
        """Genome of the prior `given`, with its very pose."""
        prior = prior_of(self.found_by.spec)
        return tuple(as_given(self.scene, prior, self.row.reshape(1))[0].tolist())


class NoPose(InputError):
    """A row without a pose that could be shown."""

    def __init__(self, number: int, outcome: Outcome, reason: str) -> None:
        why = {
            Outcome.DEAD_END: "it is a dead end, for which decoding found no pose",
            Outcome.ERROR: f"its evaluation failed: {reason}",
        }.get(outcome, "it holds none")
        super().__init__(f"There is nothing of row {number} to show: {why}.")


class NoSuchTrial(InputError):
    """A trial that is not recorded of a row."""

    def __init__(self, number: int, trial: int, recorded: int) -> None:
        there = f"trials 1 to {recorded} are" if recorded else "no trial is"
        super().__init__(
            f"Trial {trial} of row {number} is not recorded: {there}; only successes of a run under the "
            "protocol robust, or of a rerank, have any."
        )


def replay_target(folder: RunFolder, number: int, trial: int | None = None) -> ReplayTarget:
    """Find a row by its number in a folder's journal, or one of the trials of its genome.

    Raises NoSuchRow, NoSuchTrial or NoPose if there is no such row or trial, or nothing of it to show, and
    FolderError if the folder cannot be read.
    """
    with folder.journal() as journal:
        row = row_at(folder, journal, number)
        found_by = provenance(folder, journal)
        if trial is not None and trial != row["trial"]:
            number, row = _trial_of(journal, number, row, trial)
        if not row["base_to_object"].any():
            reason = journal.errors().get(number, "why is not recorded")
            raise NoPose(number, Outcome(row["outcome"]), reason)
    scene = folder.scene()
    return ReplayTarget(number, row, found_by, scene, folder.bundle())


def _trial_of(journal: Journal, number: int, row: np.void, trial: int) -> tuple[int, np.void]:
    first = recorded = 0
    for rows in journal.blocks():
        is_its = (rows["generation"] == row["generation"]) & (rows["index"] == row["index"])
        for place in np.flatnonzero(is_its).tolist():
            recorded = max(recorded, int(rows["trial"][place]))
            if rows["trial"][place] == trial:
                return first + place, rows[place]
        first += len(rows)
    raise NoSuchTrial(number, trial, recorded)


REPLAY_MODULE = "qdgrasp_worker.replay"
POLL_INTERVAL = 0.05  # seconds between two looks whether it is done


class ReplayFailed(QdgraspError):
    """The process that replays ended without an answer."""

    def __init__(self, death: ProcessExit) -> None:
        super().__init__(f"The process that replays {death.description}. {death.words}".strip())


def replay_evaluation(shown: ReplayTarget, stop: Stop) -> ReplayAnswer | None:
    """Replay a row in a process of its own; None where a signal came first.

    Raises ReplayFailed if its replay failed.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        folder = Path(name)
        (folder / SCENE).write_bytes(shown.bundle.payload)
        request = ReplayRequest(genome=shown.genome, trial=shown.trial)
        (folder / REQUEST).write_bytes(msgspec.json.encode(request))
        _run_process(folder, stop)
        if stop.is_set:
            return None
        return msgspec.json.decode((folder / ANSWER).read_bytes(), type=ReplayAnswer)


def local_platform() -> dict[str, str]:
    """Return the entries that decide the bits of results on this machine."""
    command = [sys.executable, "-m", "qdgrasp_worker.cli", "--self-test"]
    test = subprocess.run(command, capture_output=True, check=True, text=True)
    return dict(json.loads(test.stdout))


def _run_process(folder: Path, stop: Stop) -> None:
    with ProcessSupervisor(folder, GRACE) as processes:
        processes.start("replay", REPLAY_MODULE, [str(folder)])
        while not (stop.is_set or (ended := processes.exits())):
            with suppress(subprocess.TimeoutExpired):
                processes.process("replay").wait(POLL_INTERVAL)
        for death in () if stop.is_set else ended:
            if death.exit_code:
                raise ReplayFailed(death)
