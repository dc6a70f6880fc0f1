"""What a worker answers."""

from qdgrasp_protocol import codec
from qdgrasp_protocol.messages import Result, Work
from qdgrasp_worker.service import SLICE, failed, slices

WORK = Work(
    epoch=3,
    run="run",
    scene="0" * 64,
    prior="contact",
    generation=2,
    batch=bytes(16),
    attempt=1,
    join=1,
    n=3,
    genes=7,
    columns={},
)


def test_a_batch_that_cannot_be_evaluated_is_answered_with_every_row_failed():
    result = failed(WORK, "a" * 32, "not a scene: " + "é" * 500)
    assert [failure.row for failure in result.failures] == [0, 1, 2]
    assert (result.epoch, result.generation, result.batch) == (WORK.epoch, WORK.generation, WORK.batch)
    assert codec.decode(codec.encode(result), Result) == result


def test_slices_cover_every_row_once():
    for n in (1, SLICE, SLICE + 1, 5 * SLICE - 1):
        assert [row for place in slices(n) for row in range(place.start, place.stop)] == list(range(n))
