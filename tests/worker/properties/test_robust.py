"""The protocol robust: trial 0 is the paper's evaluation, each trial a function of its own."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.common import PATIENCE

from qdgrasp_assets.scene import pack_scene
from qdgrasp_protocol.rows import RESULT, TRIALS, Outcome, pack
from qdgrasp_worker.evaluation_protocols import MIXTURE, PROTOCOLS, ROBUST
from qdgrasp_worker.evaluator import Evaluator

GENOMES = 900
FEW = {Outcome.DROPPED: 1, Outcome.SHAKEN: 1, Outcome.HELD: 1}
MANY = {Outcome.DROPPED: 18, Outcome.SHAKEN: 14, Outcome.HELD: 10}
"""Number of successes of each outcome that are tried a hundred times."""
ELSEWHERE = """
import sys
from pathlib import Path
import numpy as np
from qdgrasp_assets.scene import unpack_scene
from qdgrasp_worker.evaluator import Evaluator
folder = Path(sys.argv[1])
with Evaluator(unpack_scene((folder / "scene").read_bytes())) as evaluator:
    genomes, trials = np.load(folder / "genomes.npy"), np.load(folder / "trials.npy")
    rows = evaluator.evaluate("approach", genomes, trials).rows
np.save(folder / "rows.npy", rows)
"""


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene("panda", "tennis_ball", "robust")


@pytest.fixture(scope="module")
def genomes(draw):
    return draw(GENOMES, seed=7)


@pytest.fixture(scope="module")
def nominal(scene, genomes):
    return evaluated(scene, genomes, np.zeros(GENOMES))


@pytest.fixture(scope="module")
def mixed(nominal):
    """Successes in a few of their trials each, trial 0 among them, genomes mixed."""
    some = nominal[nominal["outcome"] >= Outcome.DROPPED]["genome"][:30]
    trials = np.tile([0, 1, 2, 50, TRIALS], len(some))
    return np.repeat(some, 5, axis=0), trials


@pytest.fixture(scope="module")
def rows(scene, mixed):
    return evaluated(scene, *mixed)


def evaluated(scene, genomes, trials, prior="approach"):
    with Evaluator(scene) as evaluator:
        evaluation = evaluator.evaluate(prior, genomes, np.asarray(trials, dtype=np.uint16))
    assert not evaluation.failures
    return evaluation.rows


def results(rows, *but: str):
    return pack(rows, [column for column in RESULT if column.name not in but])


def test_trial_zero_is_the_evaluation_of_paper_to_the_byte(make_scene, nominal):
    some = nominal[::3]
    paper = make_scene("panda", "tennis_ball", "paper")
    assert results(evaluated(paper, some["genome"], some["trial"])) == results(some)


@pytest.mark.parametrize(
    "successes",
    [FEW, pytest.param(MANY, marks=(pytest.mark.slow, pytest.mark.timeout(900)))],
    ids=["few", "many"],
)
def test_without_noise_a_hundred_trials_add_up_to_a_hundred_times_the_nominal_fitness(
    scene, nominal, successes, monkeypatch
):
    own = scene.object.rolling_friction, scene.object.spinning_friction
    still = replace(
        MIXTURE, position_sigma=0.0, angle_sigma=0.0, rolling=(own[0], own[0]), spinning=(own[1], own[1])
    )
    monkeypatch.setitem(PROTOCOLS, "robust", replace(ROBUST, mixture=still))
    places = [np.flatnonzero(nominal["outcome"] == outcome)[:n] for outcome, n in successes.items()]
    chosen = nominal[np.concatenate(places)]
    assert [len(found) for found in places] == list(successes.values())
    again = evaluated(scene, np.repeat(chosen["genome"], TRIALS, axis=0), np.tile(range(1, 101), len(chosen)))
    sums = again["fitness"].reshape(len(chosen), TRIALS).sum(axis=1)
    np.testing.assert_array_equal(sums, TRIALS * chosen["fitness"])
    assert results(again) == results(np.repeat(chosen, TRIALS))


def test_the_sample_has_trials_of_every_kind(mixed, rows):
    outcomes = rows["outcome"][mixed[1] > 0]
    assert (outcomes == Outcome.OVERLAP).sum() >= 5
    assert (outcomes == Outcome.BRUSHED).sum() >= 5
    assert (outcomes >= Outcome.SHAKEN).sum() >= 20


def test_a_trial_says_the_commanded_pose_and_what_it_found(mixed, rows):
    first = rows[mixed[1] == 0]
    for name in ("descriptor", "base_to_object", "surface_point", "nu"):
        np.testing.assert_array_equal(rows[name], np.repeat(first[name], 5, axis=0))
    held = rows[(mixed[1] == 1) & (rows["outcome"] == Outcome.HELD)]
    before = first[rows["outcome"][mixed[1] == 1] == Outcome.HELD]
    assert (held["joints"] != before["joints"]).any(axis=1).all()


def test_an_overlap_that_the_noise_causes_counts_nothing(rows):
    assert not rows["fitness"][rows["outcome"] == Outcome.OVERLAP].any()


def test_a_permutation_of_trials_changes_no_byte_of_any(scene, mixed, rows):
    genomes, trials = mixed
    place = np.random.default_rng(1).permutation(len(trials))
    assert results(evaluated(scene, genomes[place], trials[place])) == results(rows[place])


def test_a_nominal_row_after_a_trial_is_as_if_there_had_been_none(scene, mixed, rows):
    first = mixed[1] == 0
    assert results(rows[first]) == results(evaluated(scene, mixed[0][first], np.zeros(first.sum())))


def test_rows_one_by_one_are_the_same(scene, mixed, rows):
    genomes, trials = mixed
    with Evaluator(scene) as evaluator:
        alone = [
            evaluator.evaluate("approach", genomes[i : i + 1], trials[i : i + 1].astype(np.uint16)).rows
            for i in range(60)
        ]
    assert results(np.concatenate(alone)) == results(rows[:60])


def test_another_process_finds_the_same(scene, mixed, rows, tmp_path):
    np.save(tmp_path / "genomes.npy", mixed[0])
    np.save(tmp_path / "trials.npy", mixed[1].astype(np.uint16))
    (tmp_path / "scene").write_bytes(pack_scene(scene).payload)
    subprocess.run([sys.executable, "-c", ELSEWHERE, str(tmp_path)], check=True, timeout=PATIENCE)
    assert results(np.load(Path(tmp_path, "rows.npy"))) == results(rows)


def test_a_stored_pose_that_is_scored_as_given_meets_the_same_trials(scene, mixed, rows):
    again = evaluated(scene, rows["base_to_object"], mixed[1], prior="given")
    assert results(again, "surface_point", "nu") == results(rows, "surface_point", "nu")


def test_noise_makes_most_grasps_worse_and_some_fail(mixed, rows):
    trials = rows["fitness"].reshape(-1, 5)
    assert trials[:, 1:].mean() < trials[:, 0].mean()
    assert len(np.unique(trials[trials[:, 0] == 2][:, 1:])) == 3
