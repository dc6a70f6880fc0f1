"""Coverage: how much of a reference set a run has found (cvg in Huber et al. 2024, section IV)."""

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.analysis.reference import ReferenceSet
from qdgrasp_coordinator.analysis.released import ReleasedArchive
from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.scores import ROBUST
from qdgrasp_protocol.phrases import counted


class Coverage(Struct, frozen=True, kw_only=True):
    """What was found of a reference set. Ratios are None where their denominator is 0."""

    coverage: float | None
    """`found` over `size`, 0 to 1."""
    robust: float | None
    """`robust_found` over `robust_size`, 0 to 1."""
    released: float | None
    """`released_found` over `size`: the figure of the authors' code, which counts elites, not positions."""
    released_robust: float | None
    """Elites of fitness 2 whose position is in the set, over `robust_size`; may exceed 1."""
    size: int
    """Entries of the set."""
    found: int
    """Distinct success positions, rounded to 1 cm, that are in the set."""
    outside: int
    """Distinct success positions, rounded to 1 cm, that are not."""
    robust_size: int
    """Entries of the set with fitness 2."""
    robust_found: int
    """Those in which a success of fitness 2 was found."""
    released_found: int | None
    """Elites of the released code's archive whose position is in the set; None for a foreign hand or set."""
    sentence: str = ""
    """The result in words."""


def coverage(
    positions: NDArray[np.floating],
    fitness: NDArray[np.number],
    reference: ReferenceSet,
    archive: ReleasedArchive | None = None,
) -> Coverage:
    """Compare a run's successes with a reference set.

    Parameters
    ----------
    positions
        (n, 3) [m]: the hand at each success, CoM frame, in journal order.
    fitness
        (n,): shakes survived by each.
    reference
        The set of the same object.
    archive
        The released code's archive for this scene; None leaves its figures out, and so does a set of one's
        own, which that code never had.
    """
    reached, robust = cells(positions), reference.robust
    distinct = np.unique(reached, axis=0)
    found = _shared(distinct, reference)
    robust_found = _shared(np.unique(reached[fitness == ROBUST], axis=0), robust)
    elites, robust_elites = _released(reached, positions, fitness, reference, archive)
    result = Coverage(
        coverage=_ratio(found, len(reference)),
        robust=_ratio(robust_found, len(robust)),
        released=_ratio(elites, len(reference)),
        released_robust=_ratio(robust_elites, len(robust)),
        size=len(reference),
        found=found,
        outside=len(distinct) - found,
        robust_size=len(robust),
        robust_found=robust_found,
        released_found=elites,
    )
    return msgspec.structs.replace(result, sentence=_sentence(result, reference.object))


def _released(
    reached: NDArray[np.int64],
    positions: NDArray[np.floating],
    fitness: NDArray[np.number],
    reference: ReferenceSet,
    archive: ReleasedArchive | None,
) -> tuple[int | None, int | None]:
    """Elites in the set, and those of them with fitness 2."""
    if archive is None or reference.origin is not None:
        return None, None
    elites = archive.elites(positions, fitness)
    robust = elites[fitness[elites] == ROBUST]
    return _shared(reached[elites], reference), _shared(reached[robust], reference)


def _shared(positions: NDArray[np.int64], reference: ReferenceSet) -> int:
    """How many of `positions` (n, 3) are cells of the set; repeated ones count repeatedly."""
    return int(np.isin(keys(positions), keys(reference.cells)).sum())


def _ratio(found: int | None, size: int) -> float | None:
    return None if found is None or size == 0 else found / size


def _sentence(result: Coverage, name: str) -> str:
    if result.coverage is None:
        return f"The reference set of '{name}' is empty, so that there is no coverage of it."
    return (
        f"{result.found} of the {result.size} cells of '{name}' were found ({result.coverage:.2%}), "
        f"and {counted(result.outside, 'cell that is', 'cells that are')} not in the set."
        f"{_robust(result)}{_as_released(result)}"
    )


def _robust(result: Coverage) -> str:
    if result.robust is None:
        return ""
    found = f"{result.robust_found} of the {result.robust_size} that have it in the set"
    return f" With fitness 2 were found {found} ({result.robust:.2%})."


def _as_released(result: Coverage) -> str:
    if result.released is None:
        return ""
    return f" The released code counts {result.released_found} of the {result.size} ({result.released:.2%})."
