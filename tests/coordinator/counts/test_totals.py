"""What several runs found together."""

from tests.coordinator.recorded_runs import random_rows

from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.counts.totals import NOTHING, totals
from qdgrasp_protocol.outcome import Outcome


def test_totals_are_the_sums_of_what_tallies_count() -> None:
    found = NOTHING
    for seed in (0, 1):
        rows = random_rows(50, seed)
        rows["outcome"][:5], rows["proposals"] = Outcome.DEAD_END, 3
        tally = Tally(100, "redraw")
        tally.count(rows)
        found += totals(tally)
    assert (found.proposals, found.dead_ends, found.trials) == (300, 10, 0)
    assert found.evaluations == found.simulated == 90 - found.overlaps
    assert found.cells <= found.successes < found.simulated
    assert found + NOTHING == found
    assert found.overlaps > 0
