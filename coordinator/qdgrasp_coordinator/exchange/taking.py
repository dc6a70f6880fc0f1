"""Taking grasps from the journal of a run."""

from collections.abc import Iterator
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.counts.scores import Scores, eta, genome_numbers
from qdgrasp_coordinator.counts.whole import joined, taken
from qdgrasp_coordinator.exchange.grasps import Found, Grasps
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.trials import trials


class Section(NamedTuple):
    """The rows of one run in a journal: `start` to `stop`."""

    found: Found
    start: int
    stop: int


def read_grasps(folder: RunFolder, least: Outcome = Outcome.DROPPED) -> Grasps:
    """The nominal evaluations in a run's folder that got as far as `least`, in journal order.

    Parameters
    ----------
    folder
        Any run's, also while it goes on: what is recorded by now.
    least
        `DROPPED`: all successes; `MISSED`: all that were simulated. A pruned or merged folder has kept
        successes alone.

    Raises
    ------
    FolderError
        The folder cannot be read, or has no scene yet.
    """
    scene = folder.scene()
    with folder.journal() as journal:
        sections = _sections(folder, journal)
        parts = [_part(journal, section, least) for section in sections]
    return Grasps(
        scene=scene,
        spec=folder.spec,
        sources=tuple(section.found for section in sections),
        origins=np.repeat(np.arange(len(parts)), [len(part.rows) for part in parts]),
        numbers=np.concatenate([part.numbers for part in parts]),
        rows=joined([part.rows for part in parts]),
        eta=np.concatenate([part.eta for part in parts]),
    )


class _Part(NamedTuple):
    numbers: NDArray[np.int64]
    rows: Rows
    eta: Floats


def _sections(folder: RunFolder, journal: Journal) -> list[Section]:
    """Which rows are whose; all are the folder's own unless it was merged or pruned."""
    if not journal.sources:
        return [Section(Found(folder.path.absolute().name, folder.spec), 0, journal.count)]
    ends = [0, *accumulate(source.kept for source in journal.sources)]
    return [
        Section(Found(source.run, source.asked), start, stop)
        for source, start, stop in zip(journal.sources, ends, ends[1:], strict=False)
    ]


def _part(journal: Journal, section: Section, least: Outcome) -> _Part:
    """What one run has: its rows that got far enough, and what their trials came to."""
    known = trials(section.found.spec.protocol)
    scores, first = Scores(known), section.start
    numbers, rows, scored = [np.zeros(0, np.int64)], [journal.shape.empty(0)], [journal.shape.empty(0)]
    for block in _blocks(journal, section):
        here = np.flatnonzero((block["trial"] == 0) & (block["outcome"] >= least))
        numbers.append(first + here)
        rows.append(taken(block, here))
        if known:
            scored.append(scores.take(block))
        first += len(block)
    found = joined(rows)
    return _Part(np.concatenate(numbers), found, _etas(found, joined(scored), known))


def _blocks(journal: Journal, section: Section) -> Iterator[Rows]:
    return journal.kept(section.start, section.stop) if section.start < section.stop else iter(())


def _etas(rows: Rows, scored: Rows, known: int) -> Floats:
    """The eta of each row (n,), NaN where its trials are not complete or there are none."""
    found = np.full(len(rows), np.nan)
    if known:
        found[np.searchsorted(genome_numbers(rows), genome_numbers(scored))] = eta(scored["fitness"], known)
    return found
