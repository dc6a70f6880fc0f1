"""A user's evaluator in the simulator's place."""

import sys
from pathlib import Path

import numpy as np
import pytest
from tests.worker.genomes import draw
from tests.worker.runtime import evaluators
from tests.worker.runtime.evaluators import Height, Squeamish

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import Device
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.runtime import simulator_supervisor
from qdgrasp_worker.runtime.custom_evaluator import CustomEvaluator, custom_platform, load_evaluator
from qdgrasp_worker.runtime.evaluator_api import BadVerdict, Hands, Verdicts

HERE = Path(evaluators.__file__)


@pytest.fixture(autouse=True)
def _forgets() -> None:
    evaluators.ASKED.clear()


def hands(n: int) -> Hands:
    return Hands(
        base_to_object=np.zeros((n, 7), np.float32),
        joints=np.full((n, 2), 0.04, np.float32),
        synergies=np.full(n, -1),
        frictions=np.zeros((n, 2)),
        trials=np.zeros(n, np.uint16),
        surface_points=np.zeros((n, 3), np.float32),
        prior="approach",
        genomes=np.zeros((n, 7), np.float32),
    )


def test_hands_stand_where_the_simulator_would_put_them(cube: Scene, evaluator: Evaluator) -> None:
    genomes, trials = draw(40), np.zeros(40, np.uint16)
    ours = evaluator.evaluate("approach", genomes, trials).rows
    found = CustomEvaluator(cube, Height).evaluate("approach", genomes, trials)
    assert found.failures == []
    for column in ("genome", "trial", "base_to_object", "descriptor", "surface_point", "nu"):
        assert found.rows[column].tobytes() == ours[column].tobytes(), column
    assert not found.rows["steps"].any()


def test_verdicts_fill_the_rows(cube: Scene) -> None:
    rows = CustomEvaluator(cube, Height).evaluate("approach", draw(40), np.zeros(40, np.uint16)).rows
    above = rows["base_to_object"][:, 2] > cube.object_high[2]
    assert 0 < above.sum() < 40
    assert (rows["outcome"] == np.where(above, Outcome.HELD, Outcome.MISSED)).all()
    assert (rows["fitness"] == np.where(above, 2, 0)).all()
    opened = [joint.opened for joint in cube.gripper.joints]
    assert rows["joints"] == pytest.approx(np.tile(opened, (40, 1)))


def test_a_hand_that_cannot_be_judged_fails_alone(cube: Scene) -> None:
    found = CustomEvaluator(cube, Squeamish).evaluate("approach", draw(20), np.zeros(20, np.uint16))
    sure = CustomEvaluator(cube, Height).evaluate("approach", draw(20), np.zeros(20, np.uint16)).rows
    bad = np.flatnonzero(sure["base_to_object"][:, 0] > 0)
    assert [place for place, _ in found.failures] == bad.tolist()
    assert {reason for _, reason in found.failures} == {"ValueError: not there"}
    assert not found.rows["base_to_object"][bad].any()
    assert found.rows["genome"].tobytes() == sure["genome"].tobytes()
    others = np.setdiff1d(np.arange(20), bad)
    assert found.rows[others].tobytes() == sure[others].tobytes()


def test_trials_show_the_hand_as_the_object_is_disturbed(make_scene) -> None:
    own = CustomEvaluator(make_scene("panda", "rubiks_cube", "robust"), Height)
    genomes = np.repeat(draw(1), 3, axis=0)
    own.evaluate("approach", genomes, np.array([0, 1, 2], np.uint16))
    poses = evaluators.ASKED[0].base_to_object
    assert len(np.unique(poses, axis=0)) == 3
    assert np.linalg.norm(poses[:, 3:], axis=1) == pytest.approx(np.ones(3), abs=1e-6)
    assert evaluators.ASKED[0].trials.tolist() == [0, 1, 2]
    assert len(np.unique(evaluators.ASKED[0].frictions, axis=0)) == 3


@pytest.mark.parametrize(
    ("verdicts", "words"),
    [
        (Verdicts(np.full(3, 7)), r"outcomes must be numbers of shape \(2,\), got int64 of \(3,\)"),
        (Verdicts(np.array(["held", "held"])), "outcomes must be numbers"),
        (Verdicts(np.array([0, 7])), r"outcomes must be 2 \(OVERLAP\) to 7 \(HELD\)"),
        (Verdicts(np.full(2, 7), fitness=np.array([1.0, np.nan])), "fitness must be finite"),
        (Verdicts(np.full(2, 7), penetration=np.array([0.0, -1.0])), "penetration must be finite and at le"),
        (Verdicts(np.full(2, 7), joints=np.zeros((2, 5))), r"joints must be numbers of shape \(2, 2\)"),
    ],
)
def test_what_is_no_verdict_is_said_to_be_none(verdicts: Verdicts, words: str) -> None:
    with pytest.raises(BadVerdict, match=words):
        verdicts.columns(hands(2), 2)


def test_an_evaluator_is_found_in_a_file_and_in_a_module() -> None:
    make, file = load_evaluator(f"{HERE}:Height")
    assert (make.__name__, file) == ("Height", HERE)  # type: ignore[attr-defined]
    assert sys.modules["evaluators"].__name__ == "evaluators"
    assert load_evaluator("tests.worker.runtime.evaluators:Height")[0] is Height


@pytest.mark.parametrize(
    "what", [f"{HERE}:Width", "no.such.module:Height", f"{HERE.with_name('absent.py')}:Height"]
)
def test_an_evaluator_that_is_not_there_is_said_not_to_be(what: str) -> None:
    with pytest.raises(InputError, match="No evaluator can be loaded from"):
        load_evaluator(what)


def test_the_platform_changes_with_the_evaluators_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("A = 1")
    before = custom_platform("mine.py:A", file)
    file.write_text("A = 2")
    after = custom_platform("mine.py:A", file)
    assert {name for name in before if before[name] != after[name]} == {"evaluator_file"}


@pytest.mark.parametrize(
    ("name", "device", "words"),
    [
        ("Height", None, "named FILE.py:NAME or MODULE:NAME, got 'Height'"),
        ("absent.py:Height", None, "There is no file"),
        (f"{HERE}:Height", Device("cuda", 64), "leave out --device or --evaluator"),
    ],
)
def test_a_worker_says_at_once_that_an_evaluator_cannot_be(name, device, words) -> None:
    with pytest.raises(InputError, match=words):
        simulator_supervisor.simulator_command(name, device)
