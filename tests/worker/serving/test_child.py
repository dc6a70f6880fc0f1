"""What a simulator's process does with rows."""

from qdgrasp_worker.serving.child import SLICE, slices


def test_slices_cover_every_row_once():
    for n in (1, SLICE, SLICE + 1, 5 * SLICE - 1):
        assert [row for place in slices(n, SLICE) for row in range(place.start, place.stop)] == list(range(n))
