"""A specimen: one row of a journal, with all that it takes to carry its evaluation out again."""

from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.analysis.profile import numbered
from qdgrasp_coordinator.counts.poses import as_given
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.provenance import Provenance, provenance
from qdgrasp_coordinator.looking.own_shape import own_shape
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.outcome import Outcome


@dataclass(frozen=True)
class Specimen:
    """A row that is looked at."""

    number: int
    """Of the row in the journal."""
    row: np.void
    """In the shape of its own run."""
    found_by: Provenance
    scene: Scene
    bundle: Bundle

    @property
    def outcome(self) -> Outcome:
        """How its evaluation ended."""
        return Outcome(self.row["outcome"])

    @property
    def trial(self) -> int:
        """0: the nominal evaluation."""
        return int(self.row["trial"])

    @property
    def genome(self) -> tuple[float, ...]:
        """Of the prior `given`: its very pose."""
        prior = method(self.found_by.spec.method).prior
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


def specimen(folder: RunFolder, number: int, trial: int | None = None) -> Specimen:
    """A row by its number in a folder's journal, or one of the trials of what it evaluates.

    Raises
    ------
    NoSuchRow, NoSuchTrial, NoPose
        There is no such row or trial, or nothing of it to show.
    FolderError
        The folder cannot be read.
    """
    with folder.journal() as journal:
        row = numbered(folder, journal, number)
        found_by = provenance(folder, journal, number)
        if trial is not None and trial != row["trial"]:
            number, row = _trial_of(journal, number, row, trial, found_by)
        if not row["base_to_object"].any():
            reason = journal.errors().get(number, "why is not recorded")
            raise NoPose(number, Outcome(row["outcome"]), reason)
    scene = folder.scene()
    (own,) = own_shape(row.reshape(1), folder, found_by, scene)
    return Specimen(number, own, found_by, scene, folder.bundle())


def _trial_of(
    journal: Journal, number: int, row: np.void, trial: int, found_by: Provenance
) -> tuple[int, np.void]:
    """The number and the row of one trial of what a row evaluates."""
    first, recorded = found_by.rows.start, 0
    for rows in journal.kept(first, found_by.rows.stop):
        is_its = (rows["generation"] == row["generation"]) & (rows["index"] == row["index"])
        for place in np.flatnonzero(is_its).tolist():
            recorded = max(recorded, int(rows["trial"][place]))
            if rows["trial"][place] == trial:
                return first + place, rows[place]
        first += len(rows)
    raise NoSuchTrial(number, trial, recorded)
