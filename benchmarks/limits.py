"""Why runs do not find the rest of S_G: `python -m benchmarks.limits RUN...`.

Outcomes of the evaluations of each part of a run, and of the cells of S_G that it did not find:
whether a hand closed there without success, and how far they are from the cells that it found.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial import KDTree

from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup, ReferenceSet
from qdgrasp_coordinator.metrics.run_stats import evaluation_mask
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, Rows

PARTS = 5


@dataclass(frozen=True)
class OutcomeShares:
    """Outcomes of the counted evaluations of a part of a run, in percent."""

    until: int
    not_simulated: float
    """Dead ends and overlaps: nothing was simulated."""
    no_contact: float
    """The hand closed and did not hold the object: missed or brushed."""
    known: float
    """A success in a cell that had one."""
    elsewhere: float
    """A success in a new cell that is not of S_G."""
    new: float
    """A success in a new cell of S_G."""


@dataclass(frozen=True)
class UnfoundCells:
    """The cells of S_G without a success, in percent of S_G."""

    cells: float
    closed: float
    """Cells where a hand closed without success."""
    beside: float
    """Cells with a neighbour (of 26) that was found."""
    weak: float
    """Cells whose best known fitness is 0."""


def shares(rows: Rows, reference: ReferenceSet, counts: NDArray[np.bool_]) -> Iterator[OutcomeShares]:
    """Outcomes of the counted evaluations, in `PARTS` equal parts."""
    rows = rows[counts]
    where = cell_keys(cells(rows["descriptor"][:, :3]))
    is_found = rows["outcome"] >= Outcome.DROPPED
    is_new = np.zeros(len(rows), dtype=bool)
    is_new[np.flatnonzero(is_found)[np.unique(where[is_found], return_index=True)[1]]] = True
    is_ours = np.isin(where, cell_keys(reference.cells))
    kinds = {
        "not_simulated": rows["outcome"] <= Outcome.OVERLAP,
        "no_contact": (rows["outcome"] > Outcome.OVERLAP) & ~is_found,
        "known": is_found & ~is_new,
        "elsewhere": is_new & ~is_ours,
        "new": is_new & is_ours,
    }
    for part in np.array_split(np.arange(len(rows)), PARTS):
        yield OutcomeShares(
            int(part[-1]) + 1, **{name: 100 * float(kind[part].mean()) for name, kind in kinds.items()}
        )


def unfound_cells(rows: Rows, reference: ReferenceSet) -> UnfoundCells:
    """Figures of the cells that were not found."""
    closed = rows[rows["outcome"] >= Outcome.MISSED]
    found = np.unique(cells(closed["descriptor"][closed["outcome"] >= Outcome.DROPPED, :3]), axis=0)
    is_left = ~np.isin(cell_keys(reference.cells), cell_keys(found))
    left = reference.cells[is_left]
    tried = np.isin(cell_keys(left), cell_keys(cells(closed["descriptor"][:, :3])))
    beside = KDTree(found).query(left, p=np.inf)[0] <= 1
    weak = reference.fitness[is_left] == 0
    share = 100 / len(reference)
    return UnfoundCells(share * len(left), share * tried.sum(), share * beside.sum(), share * weak.sum())


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables of each run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.limits", description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs on objects that S_G has")
    targets, console = ReferenceLookup(), Console()
    for path in parser.parse_args(arguments).runs:
        folder = RunFolder.open(path)
        reference = targets.of(folder.scene(), folder.spec.object).reference
        with folder.journal() as journal:
            rows = np.concatenate([part.rows for part in journal.slices()])
        rows = rows[rows["trial"] == 0]
        table = Table(
            "evaluations",
            *(name for name in OutcomeShares.__annotations__ if name != "until"),
            title=path.name,
        )
        for share in shares(rows, reference, evaluation_mask(rows, folder.spec.overlaps)):
            values = (share.not_simulated, share.no_contact, share.known, share.elsewhere, share.new)
            table.add_row(f"to {share.until}", *(f"{value:.1f} %" for value in values))
        console.print(table)
        left = unfound_cells(rows, reference)
        console.print(
            f"{left.cells:.1f} % of S_G was not found: a hand closed in {left.closed:.1f} % without success, "
            f"{left.beside:.1f} % lie beside a cell that was found, {left.weak:.1f} % survive no shake in S_G"
        )


if __name__ == "__main__":
    main()
