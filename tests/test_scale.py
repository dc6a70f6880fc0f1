"""What the scale benchmark measures with; its figures are not tested."""

import numpy as np
import pytest
from tests.benchmarks.scale.dispatching import BATCH, Prepared, spec
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.prepared import SHAPE, VARIETY, Answers, rows
from tests.benchmarks.scale.rig import JOB, Several, Watch, assignment, coordinate, resident, router
from tests.benchmarks.scale.searching import Watched
from tests.benchmarks.scale.stand_ins import Crowd, crowds
from tests.benchmarks.scale.turns import Timed, compared, take_turns
from tests.benchmarks.scale.watched import monitors
from tests.coordinator.searches.spaces import plain
from tests.endpoints import own_endpoint

from qdgrasp_coordinator.bench.course import Unkept
from qdgrasp_coordinator.dispatching.batch import readable
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol import codec
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.outcome import Outcome

WID = "0" * 32


def test_a_prepared_result_answers_the_batch_that_it_is_filled_in_for() -> None:
    answers = Answers(3, WID, epoch=2, run="run", n=5, seconds=0.5)
    results = [
        codec.decode(answers.to(number, bytes([number]) * 16, number + 1), Result)
        for number in range(VARIETY)
    ]
    assert [(each.generation, each.batch[0], each.attempt) for each in results] == [
        (number, number, number + 1) for number in range(VARIETY)
    ]
    assert all((each.epoch, each.wid, each.n, each.failures) == (2, WID, 5, []) for each in results)
    read = [readable(each, SHAPE)[1] for each in results]
    assert len({found["descriptor"].tobytes() for found in read}) == VARIETY


def test_prepared_rows_are_of_every_kind_that_random_poses_are_of() -> None:
    found = rows(1000, np.random.default_rng(0))
    assert set(np.unique(found["outcome"])) == {Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD}
    np.testing.assert_array_equal(found["fitness"] == 2, found["outcome"] == Outcome.HELD)


@pytest.mark.parametrize("seconds", [0.0, 0.01])
def test_a_coordinator_is_watched_while_stand_ins_answer(seconds: float) -> None:
    runs = [assignment("run", spec("contact_rand", 4 * BATCH), Prepared(4 * BATCH), 2)]
    with router() as (endpoint, pid), crowds([Crowd(endpoint, JOB, 2, seconds=seconds)]) as crew:
        watch = Watch(crew, runs, 0.0, 1.0)
        memory: list[int] = []
        watch.at_join = lambda: memory.append(resident(pid))
        coordinate(endpoint, runs, lambda _: lambda run: Unkept(run.shape), watch, BATCH)
    found = watch.window
    assert found.batches > 0
    assert found.rows <= runs[0].pipeline.tally.rows
    assert found.cpu_seconds > 0
    assert memory[0] > 0


def test_a_coordinator_is_compared_with_itself_beside_monitors() -> None:
    endpoint = own_endpoint()
    with monitors(endpoint, 2, stopped=1) as company:
        (pair,) = take_turns(lambda: Timed.router(endpoint), endpoint, company, 1, 1.5)
    assert pair.alone.per_batch > 0
    assert pair.beside.shown > 0
    figures = list(compared([pair], "them"))
    assert figures[0].value == pair.beside.per_batch / pair.alone.per_batch


def test_pyribs_share_of_a_search_is_a_part_of_it() -> None:
    asked = spec("contact_me_scs", 500)
    search = Watched(method(asked.method).build(asked, plain(SHAPE.genes)))
    for generation in range(3):
        told = rows(500, np.random.default_rng(generation))
        told["genome"] = search.ask(generation)
        search.tell(generation, told)
    assert search.rows == 3 * 500
    assert 0 < search.ribs.seconds < search.whole.seconds


def test_a_run_that_is_put_back_is_the_next_one() -> None:
    asked = spec("contact_rand", 20)
    built = [assignment(name, asked, method(asked.method).build(asked, plain(SHAPE.genes))) for name in "ab"]
    programme = Several(built)
    assert programme.next() is built[0]
    programme.put_back("a")
    assert [programme.next() for _ in range(3)] == [*built, None]


@pytest.mark.parametrize(
    ("bounds", "is_met"),
    [
        ({}, None),
        ({"least": 1.0}, True),
        ({"least": 3.0}, False),
        ({"most": 3.0}, True),
        ({"most": 1.0}, False),
    ],
)
def test_a_figure_is_met_within_what_is_wanted(bounds: dict[str, float], is_met: bool | None) -> None:
    assert Figure("a", 2.0, "s", **bounds).is_met is is_met
