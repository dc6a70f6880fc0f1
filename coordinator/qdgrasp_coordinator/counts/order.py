"""The order of grasps from the best to the worst, the same wherever some of them are taken."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.rows import Rows


def best_first(rows: Rows, scores: NDArray[np.floating] | None = None) -> NDArray[np.int64]:
    """The places (n,) of nominal rows, best first.

    One row is better than another with a greater score; of equals with a greater fitness; of equals with less
    penetration; of equals with more contacts; of equals the earlier one in the journal.

    Parameters
    ----------
    scores
        (n,), NaN where a score is not known, which is worse than any; None: there are none.
    """
    known = np.zeros(len(rows)) if scores is None else np.nan_to_num(scores, nan=-1.0)
    return np.lexsort(
        (
            rows["index"],
            rows["generation"],
            -rows["contacts"].astype(np.int64),
            rows["penetration"],
            -rows["fitness"],
            -known,
        )
    )
