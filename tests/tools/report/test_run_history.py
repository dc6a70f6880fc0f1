import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows

from qdgrasp_coordinator.metrics.reference_coverage import ReferenceSet
from qdgrasp_coordinator.metrics.success_metrics import StepSeries, reference_growth
from qdgrasp_coordinator.metrics.successes import all_successes
from qdgrasp_protocol.rows import Outcome, Rows

GRID = np.stack(np.meshgrid(*[np.arange(-4, 3)] * 3), axis=-1).reshape(-1, 3).astype(np.int64)
KNOWN = ReferenceSet("block", GRID, (np.arange(len(GRID)) % 3).astype(np.uint8))


def growth(rows: Rows) -> tuple[StepSeries, StepSeries]:
    """Return entries that were found, and robust ones."""
    whole = all_successes(rows)
    return reference_growth(whole, KNOWN), reference_growth(whole, KNOWN.robust, Outcome.HELD)


@pytest.mark.parametrize("n", [0, 1, 37, 150, 600])
def test_a_curve_is_at_each_place_what_the_rows_up_to_there_give(n: int) -> None:
    rows = random_rows(600, seed=3, reach=0.05)
    assert [int(curve.after(n)) for curve in growth(rows)] == [curve.end for curve in growth(rows[:n])]
