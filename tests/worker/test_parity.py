"""Protocol `released` against the verdicts of the authors' own code, pose by pose (data/README.md)."""

from dataclasses import dataclass

import numpy as np
import pytest

from qdgrasp_assets.catalog import build_scene
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluate import Evaluator

OBJECTS = ("rubiks_cube", "mug", "power_drill")


@dataclass(frozen=True)
class Verdicts:
    """What one side says of each pose; (n,) each."""

    valid: np.ndarray
    touched: np.ndarray
    success: np.ndarray
    fitness: np.ndarray


@pytest.fixture(params=OBJECTS)
def sides(request, asset_path):
    """Our verdicts and theirs."""
    theirs = np.load(asset_path / "parity" / f"panda_2f_{request.param}.npz")
    spec = RunSpec(gripper="ref_panda_2f", object=f"ycb_{request.param}", protocol="released")
    poses = np.concatenate([theirs["base_position"], theirs["base_quaternion_xyzw"]], axis=1)
    with Evaluator(build_scene(spec)) as evaluator:
        evaluation = evaluator.evaluate("given", poses.astype(np.float32), np.zeros(len(poses), np.uint16))
    assert evaluation.failures == []
    outcomes = [Outcome(value) for value in evaluation.rows["outcome"]]
    ours = Verdicts(
        valid=np.array([outcome.is_simulated for outcome in outcomes]),
        touched=np.array([outcome.is_touched for outcome in outcomes]),
        success=np.array([outcome.is_success for outcome in outcomes]),
        fitness=evaluation.rows["fitness"],
    )
    names = ("valid", "touched", "success", "fitness")
    return ours, Verdicts(**{name: theirs[name] for name in names})


def agreement(ours, theirs, where=None):
    """The share of rows on which both sides say the same."""
    same = ours == theirs
    return same.mean() if where is None else same[where].mean()


def test_the_panda_fares_as_in_the_authors_code(sides):
    ours, theirs = sides
    assert agreement(ours.valid, theirs.valid) >= 0.99
    assert agreement(ours.touched, theirs.touched) >= 0.98
    assert agreement(ours.success, theirs.success) >= 0.98
    assert agreement(ours.success, theirs.success, ours.success | theirs.success) >= 0.90
    either = (ours.fitness >= 1) | (theirs.fitness >= 1)
    assert agreement(ours.fitness, theirs.fitness, either) >= 0.80
