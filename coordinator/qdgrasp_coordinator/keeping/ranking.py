"""Ranking: the best grasps of a run's archive, and their order once they were scored again.

A run that scores them again is a run like any other. Its folder has two files more:

* `source.json`   from which rows its poses were taken, in their order
* `ranking.csv`   its poses by eta, best first; written when it is complete
"""

import csv
import io
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.order import best_first
from qdgrasp_coordinator.counts.scores import eta, scored, sums
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.names import RANKING, SOURCE
from qdgrasp_coordinator.folders.sources import Source as JournalSource
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.trials import trials

SHOWN = 10
"""Grasps that are shown to a person."""
COLUMNS = (
    "rank", "eta", "nominal_fitness", "source_generation", "source_index", "source_fitness",
    "cell_x", "cell_y", "cell_z", "x", "y", "z", "qx", "qy", "qz", "qw",
)  # fmt: skip


class Place(Struct, frozen=True):
    """Where a pose came from."""

    generation: int
    index: int
    fitness: float
    """What the search heard of it there."""


class Source(Struct, frozen=True):
    """Where the poses of a run came from."""

    run: str
    """The folder of the run that found them."""
    rows: tuple[Place, ...]
    """In the order of the poses."""


def grasps(folder: RunFolder) -> Rows:
    """The grasps of a run (n,) in journal order, with the fitness that its search heard of them.

    A grasp survived a nominal shake; under a protocol with trials all of its own are recorded.
    """
    with folder.journal() as journal:
        _check_one_prior(journal.sources, folder.path)
        found = [journal.shape.empty(0), *scored(journal.kept(), trials(folder.spec.protocol))]
    rows = np.concatenate(found)
    return rows[rows["outcome"] >= Outcome.SHAKEN]


def _check_one_prior(sources: tuple[JournalSource, ...], where: Path) -> None:
    """Check that the genomes of all that was merged mean the same."""
    priors = sorted({method(source.asked.method).prior for source in sources})
    if len(priors) > 1:
        raise InputError(
            f"{where} is merged from runs with different priors, {' and '.join(priors)}, whose genomes mean "
            "different things; merge runs of one prior for this."
        )


def best(rows: Rows, most: int, kinds: NDArray[np.int64] | None = None) -> Rows:
    """The best row of each kind, and of these the `most` best, best first.

    Parameters
    ----------
    rows
        In any order; which is better is said in `order.best_first`.
    kinds
        (n,): a number for each row, equal for those of a kind; None: their 1 cm cells.
    """
    kinds = keys(cells(rows["descriptor"][:, :3])) if kinds is None else kinds
    order = best_first(rows)
    _, first = np.unique(kinds[order], return_index=True)
    return rows[order[np.sort(first)]][:most]


def note_source(folder: RunFolder, source: RunFolder, rows: Rows) -> None:
    """Write down from which rows of a run the poses of another were taken.

    Raises
    ------
    FolderError
        It cannot be written.
    """
    places = tuple(Place(*values) for values in rows[["generation", "index", "fitness"]].tolist())
    noted = Source(str(source.path.absolute()), places)
    disk.replace(folder.path / SOURCE, msgspec.json.encode(noted))


def is_reranking(folder: RunFolder) -> bool:
    """Whether a run scores the grasps of another."""
    return (folder.path / SOURCE).is_file()


def write_ranking(folder: RunFolder) -> str:
    """Rank the poses of a complete run that scores grasps again, and write `ranking.csv`.

    Returns
    -------
    words
        The best of them as a table.

    Raises
    ------
    FolderError
        A file cannot be read or written.
    """
    table = ranked(folder)
    disk.replace(folder.path / RANKING, _as_csv(table))
    shown = [COLUMNS[:9], *(tuple(f"{value:g}" for value in line[:9]) for line in table[:SHOWN])]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    lines = ["  ".join(map(str.rjust, line, widths)) for line in shown]
    return "\n".join([*lines, f"{counted(len(table), 'grasp')} ranked in {folder.path / RANKING}"])


def ranked(folder: RunFolder) -> list[tuple[float, ...]]:
    """The poses of a run by eta, best first, of equals in their order; each in the order of `COLUMNS`.

    What is no success any more has eta 0: it has no trials.
    """
    source = _source(folder.path)
    known = trials(folder.spec.protocol)
    with folder.journal() as journal:
        every = journal.rows(0, journal.count)
    rows, etas = every[every["trial"] == 0], eta(sums(every, known), known)
    order = np.argsort(-etas, kind="stable")
    cell = cells(rows["descriptor"][:, :3])
    return [
        (
            rank,
            float(etas[place]),
            float(rows["fitness"][place]),
            *msgspec.structs.astuple(source.rows[place]),
            *cell[place].tolist(),
            *rows["base_to_object"][place].tolist(),
        )
        for rank, place in enumerate(order.tolist(), start=1)
    ]


def _source(path: Path) -> Source:
    try:
        return msgspec.json.decode(disk.read(path / SOURCE), type=Source)
    except msgspec.MsgspecError as error:
        raise disk.damaged(path / SOURCE, str(error)) from None


def _as_csv(table: list[tuple[float, ...]]) -> bytes:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([f"{value:.9g}" for value in line] for line in table)
    return file.getvalue().encode()
