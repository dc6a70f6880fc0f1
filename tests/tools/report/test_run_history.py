from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget, ReferenceSet
from qdgrasp_coordinator.metrics.success_metrics import StepSeries, reference_growth
from qdgrasp_coordinator.metrics.successes import all_successes
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_tools.report.run_groups import RunHistory, read_history

GRID = np.stack(np.meshgrid(*[np.arange(-4, 3)] * 3), axis=-1).reshape(-1, 3).astype(np.int64)
KNOWN = ReferenceSet("block", GRID, (np.arange(len(GRID)) % 3).astype(np.uint8))


def told(tmp_path: Path, rows: Rows, **settings: object) -> RunHistory:
    folder = record(tmp_path / "run", made_scene(), rows, **settings)
    return read_history(folder, CoverageTarget(KNOWN))


def growth(rows: Rows) -> tuple[StepSeries, StepSeries]:
    """Return entries that were found, and robust ones."""
    whole = all_successes(rows)
    return reference_growth(whole, KNOWN), reference_growth(whole, KNOWN.robust, Outcome.HELD)


@pytest.mark.parametrize("n", [0, 1, 37, 150, 600])
def test_a_curve_is_at_each_place_what_the_rows_up_to_there_give(n: int) -> None:
    rows = random_rows(600, seed=3, reach=0.05)
    assert [int(curve.after(n)) for curve in growth(rows)] == [curve.end for curve in growth(rows[:n])]


def test_overlaps_are_no_evaluations_where_they_are_redrawn(tmp_path: Path) -> None:
    rows = random_rows(300)
    found = told(tmp_path, rows, overlaps="redraw")
    assert found.evaluations == np.count_nonzero(rows["outcome"] != Outcome.OVERLAP)
    assert found.cells.evaluations.max() <= found.evaluations


def test_nu_that_rounds_beyond_the_end_of_a_prior_is_still_within(tmp_path: Path) -> None:
    rows = random_rows(4)
    rows["outcome"], rows["nu"] = Outcome.HELD, [0.0, np.pi / 4, np.pi / 4 + 1e-3, np.pi]
    found = told(tmp_path, rows)
    assert found.nu.below_quarter_pi == 0.5
    assert (sum(found.nu.bins[:6]), found.nu.bins[23], sum(found.nu.bins)) == (2, 1, 4)


def test_a_run_that_has_not_begun_has_found_nothing(tmp_path: Path) -> None:
    found = told(tmp_path, random_rows(0))
    assert (found.evaluations, found.complete, found.nu.below_quarter_pi, found.cells.end) == (
        0,
        False,
        None,
        0,
    )
