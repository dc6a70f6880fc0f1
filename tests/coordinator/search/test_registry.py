"""Rules that every search keeps to."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.search import synthetic_scene, test_cma_mae, test_portfolio
from tests.coordinator.search.synthetic_scene import plain

from qdgrasp_coordinator.scheduler.pipeline import Generation, Pipeline
from qdgrasp_coordinator.search.base import SearchAlgorithm, SearchSpace, keyed_generator
from qdgrasp_coordinator.search.fixed_poses import FixedPoseSearch
from qdgrasp_coordinator.search.registry import METHODS, PORTFOLIO, Method, check_spec, method
from qdgrasp_protocol.errors import ImpossibleValue, UnknownName
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

GENES = 7
SHAPE = RowShape(genes=GENES, joints=2, contact_slots=2)
GENERATIONS = 6
POPULATION = 60
TOUCH = replace(PORTFOLIO, aim_for="touch")
SEARCHES = [TOUCH, *{entry.build: entry for entry in METHODS.values()}.values()]
"""One method of each search: the priors, which tell the others apart, mean nothing here."""


def spec(seed: int = 0, **values) -> RunSpec:
    return RunSpec(gripper="hand", object="thing", seed=seed, population=POPULATION, **values)


def space_of(entry: Method) -> SearchSpace:
    """A space of its genomes, whose meaning matters to searches that aim alone."""
    return synthetic_scene.space() if entry.aim_for else plain(GENES)


def shape_of(entry: Method) -> RowShape:
    return synthetic_scene.shape(space_of(entry)) if entry.aim_for else SHAPE


def evaluated(shape: RowShape, generation: int, genomes: np.ndarray) -> Rows:
    """Rows whose results are a function of the genomes: a third each overlap, fail, succeed."""
    rows = shape.empty(len(genomes))
    rows["generation"], rows["index"], rows["genome"] = generation, np.arange(len(genomes)), genomes
    share = (genomes[:, 3] + 1) / 2
    rows["outcome"] = np.searchsorted([0, 0, 0.3, 0.5, 0.7, 0.8, 0.9], share, side="right")
    rows["fitness"] = np.maximum(rows["outcome"].astype(float) - Outcome.DROPPED, 0)
    rows["descriptor"][:, :3] = genomes[:, :3] * np.float32(0.2)
    rows["base_to_object"][:, 6] = 1
    return rows


def asked(search: SearchAlgorithm, shape: RowShape) -> list[np.ndarray]:
    """The genomes that a search asks in its first generations."""
    all_asked = []
    for generation in range(GENERATIONS):
        genomes = search.ask(generation)
        all_asked.append(genomes.copy())
        search.tell(generation, evaluated(shape, generation, genomes))
    return all_asked


@pytest.mark.parametrize("entry", SEARCHES, ids=lambda entry: entry.name + (entry.aim_for or ""))
class TestEverySearch:
    @pytest.fixture
    def build(self, entry: Method) -> Callable[..., SearchAlgorithm]:
        return lambda seed=0: entry.build(spec(seed, aim_for=entry.aim_for), space_of(entry))

    @pytest.fixture
    def shape(self, entry: Method) -> RowShape:
        return shape_of(entry)

    def test_a_generation_has_the_population_in_float32_within_the_cube(self, build, shape) -> None:
        for genomes in asked(build(), shape):
            assert genomes.shape == (POPULATION, shape.genes)
            assert genomes.dtype == np.float32
            assert np.abs(genomes).max() <= 1

    def test_the_same_seed_asks_the_same(self, build, shape) -> None:
        assert all(map(np.array_equal, asked(build(), shape), asked(build(), shape)))

    def test_another_seed_asks_something_else_in_every_generation(self, build, shape) -> None:
        assert not any(map(np.array_equal, asked(build(0), shape), asked(build(1), shape)))

    def test_no_generation_repeats_another(self, build, shape) -> None:
        assert len({one.tobytes() for one in asked(build(), shape)}) == GENERATIONS

    def test_it_keeps_no_hold_on_the_rows_it_is_told(self, build, shape) -> None:
        one, other = build(), build()
        for generation in range(3):
            rows = evaluated(shape, generation, one.ask(generation))
            other.tell(generation, evaluated(shape, generation, other.ask(generation)))
            one.tell(generation, rows)
            rows[:] = np.zeros((), dtype=rows.dtype)
        assert np.array_equal(one.ask(3), other.ask(3))

    def test_the_order_of_arrival_changes_nothing(self, build, shape, entry: Method) -> None:
        journals = []
        for order in (np.sort, np.random.default_rng(0).permutation):
            pipeline = Pipeline(
                build(), shape, spec(evaluations=4 * POPULATION + 13, overlaps=entry.overlaps)
            )
            journals.append(b"".join(_journal(pipeline, shape, order)))
        assert journals[0] == journals[1]

    def test_a_recorded_beginning_goes_on_to_the_same_journal(self, build, shape, entry) -> None:
        recorded = 3 * POPULATION + 7
        budget = spec(evaluations=4 * POPULATION + 13, overlaps=entry.overlaps)
        whole = b"".join(_journal(Pipeline(build(), shape, budget), shape, np.sort))
        rows = np.frombuffer(whole, dtype=shape.dtype)
        pipeline = Pipeline(build(), shape, budget)
        pipeline.replay(rows[:recorded])
        assert b"".join(_journal(pipeline, shape, np.sort)) == rows[recorded:].tobytes()


def _journal(pipeline: Pipeline, shape: RowShape, order: Callable[[np.ndarray], np.ndarray]):
    while (generation := pipeline.ask()) is not None:
        rows = _rows(shape, generation)
        for place in order(np.arange(len(rows))):
            yield pipeline.settle(rows[place : place + 1]).rows.tobytes()


def _rows(shape: RowShape, generation: Generation) -> Rows:
    rows = evaluated(shape, generation.number, generation.genomes)
    rows["index"] = generation.indices
    return rows


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"aim_for": "hold", "method": "me_scs"}, "aim_for"),
        ({"diversity": "contact", "method": "me_scs"}, "diversity"),
        ({"diversity": "contact", "method": "antipodal_cells"}, "diversity"),
    ],
)
def test_what_a_search_cannot_do_is_refused_in_one_sentence(values, key) -> None:
    with pytest.raises(ImpossibleValue, match=f"^{key} must be ") as refused:
        check_spec(spec(**values))
    assert str(refused.value).count("\n") == 0


def test_an_unknown_method_is_refused_with_the_known_ones_named() -> None:
    with pytest.raises(UnknownName, match=r"Unknown method 'contact_me_sc'.*'contact_me_scs'.*approach_rand"):
        method("contact_me_sc")


def test_a_pipeline_of_given_poses_ends_also_when_they_do_not_spend_the_budget() -> None:
    pipeline = Pipeline(
        FixedPoseSearch(np.zeros((5, 7), np.float32), population=10), SHAPE, spec(evaluations=6)
    )
    assert len(pipeline.settle(_rows(SHAPE, pipeline.ask()))) == 5
    assert pipeline.finished == "the search has nothing left to ask"


@pytest.mark.parametrize("outcome", [Outcome.ERROR, Outcome.DEAD_END, Outcome.OVERLAP])
def test_cma_mae_never_inserts_what_was_rejected(outcome: Outcome) -> None:
    """Here, because pyribs is compiled for seconds in each process."""
    search = test_cma_mae.CmaMae(test_cma_mae.spec(), test_cma_mae.SHAPE.genes, test_cma_mae.BOX)
    test_cma_mae.play(search, 3)
    before = len(search._archive)
    test_cma_mae.play(search, 3, outcome)
    assert len(search._archive) == before > 0


def test_a_fresh_process_asks_the_same_bits() -> None:
    """Of the default search; the golden runs are of the others too."""
    command = f"import {test_portfolio.__name__} as here; print(here.digest())"
    there = subprocess.run(
        [sys.executable, "-c", command],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    assert there.stdout.split() == [test_portfolio.digest()]


def test_the_numbers_stay_the_same_from_version_to_version() -> None:
    """Journals hold what was drawn: were this to change, no old run could be resumed."""
    drawn = keyed_generator(0, "uniform", 0).integers(0, 2**32, 3)
    assert drawn.tolist() == [4054646954, 1409545429, 458180423]
