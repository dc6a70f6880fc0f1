from qdgrasp_coordinator.analysis.growth import growth
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Shape


def test_successes_and_their_cells_are_counted_along_the_nominal_rows() -> None:
    rows = Shape(7, 2).empty(6)
    rows["outcome"] = [
        Outcome.MISSED,
        Outcome.HELD,
        Outcome.DROPPED,
        Outcome.HELD,
        Outcome.OVERLAP,
        Outcome.HELD,
    ]
    rows["descriptor"][:, 0] = [0.05, 0.01, 0.012, 0.03, 0.07, 0.09]
    rows["trial"] = [0, 0, 0, 0, 0, 1]
    found = growth(rows)
    assert found.evaluations.tolist() == [0, 1, 2, 3, 4, 5, 5]
    assert found.successes.tolist() == [0, 0, 1, 2, 3, 3, 3]
    assert found.cells.tolist() == [0, 0, 1, 1, 2, 2, 2]


def test_overlaps_are_no_evaluations_where_they_are_redrawn() -> None:
    rows = Shape(7, 2).empty(3)
    rows["outcome"] = [Outcome.OVERLAP, Outcome.MISSED, Outcome.OVERLAP]
    assert growth(rows, "redraw").evaluations.tolist() == [0, 0, 1, 1]


def test_nothing_grows_from_nothing() -> None:
    assert growth(Shape(7, 2).empty(0)).cells.tolist() == [0]
