"""Parity of hands with the verdicts of the authors' own code, pose by pose.

Built-in hands are compared with the reference hands on the same poses; protocol `released` (data/README.md,
docs/decisions/0009-grippers-and-inference.md).
"""

from functools import cache

import numpy as np
import pytest
from tests.worker import genomes

from qdgrasp_assets.catalog import build_scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec

OBJECTS = ("rubiks_cube", "mug", "power_drill")
FITNESS = {"allegro": 0.75, "bh280": 0.70, "panda_2f": 0.75, "shadow": 0.75}
"""Share of grasps of either side with the same fitness; Barrett agrees with itself on 85 %."""
FEW = 30
"""Classes with fewer rows are not judged."""
NAMES, POSE = ("valid", "touched", "success"), ("base_position", "base_quaternion_xyzw", "synergy", "spread")
"""Columns that are read of a file."""


def verdicts(valid, touched, success, fitness):
    """Verdicts (n,) of one side on each pose."""
    names = ("valid", "touched", "success", "fitness")
    return np.rec.fromarrays([valid, touched, success, fitness], names=names)


def recorded(path, hand, target, every=1):
    """The poses of a file, or every so many, as genomes of the prior `given`, and the verdicts."""
    with np.load(path / "parity" / f"{hand}_{target}.npz") as kept:
        file = {name: kept[name][::every] for name in (*NAMES, "fitness", *POSE)}
    columns = [file["base_position"], file["base_quaternion_xyzw"]]
    if (file["synergy"] >= 0).any():
        columns.append(file["synergy"][:, None])
    if np.isfinite(file["spread"]).any():
        columns.append(file["spread"])
    theirs = verdicts(*(file[name].astype(bool) for name in NAMES), file["fitness"])
    return np.concatenate(columns, axis=1).astype(np.float32), theirs


def evaluated(gripper, target, poses):
    """Our verdicts on poses."""
    spec = RunSpec(gripper=gripper, object=f"ycb_{target}", protocol="released")
    rows = genomes.evaluated(build_scene(spec), "given", poses)
    said = [(each.is_simulated, each >= Outcome.BRUSHED, each.is_success) for each in genomes.outcomes(rows)]
    return verdicts(*np.array(said).T, rows["fitness"])


@cache
def sides(path, hand, target, every=1):
    """The reference hand's verdicts, and the authors', on all poses or every so many."""
    poses, theirs = recorded(path, hand, target, every)
    return evaluated(f"ref_{hand}", target, poses), theirs


def agreement(ours, theirs, where=None):
    """The share of rows on which both sides say the same."""
    same = ours == theirs
    return same.mean() if where is None else same[where].mean()


@pytest.mark.parametrize(
    "target", [pytest.param(each, marks=pytest.mark.slow if each == "mug" else ()) for each in OBJECTS]
)
def test_the_panda_fares_as_in_the_authors_code(target, asset_path):
    ours, theirs = sides(asset_path, "panda_2f", target, every=3)
    assert agreement(ours.valid, theirs.valid) >= 0.99
    assert agreement(ours.touched, theirs.touched) >= 0.98
    assert agreement(ours.success, theirs.success) >= 0.98
    assert agreement(ours.success, theirs.success, ours.success | theirs.success) >= 0.90
    either = (ours.fitness >= 1) | (theirs.fitness >= 1)
    assert agreement(ours.fitness, theirs.fitness, either) >= 0.80


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("hand", FITNESS)
def test_every_reference_hand_fares_as_in_the_authors_code(hand, asset_path):
    files = [sides(asset_path, hand, target) for target in OBJECTS]
    for ours, theirs in files:
        assert agreement(ours.valid, theirs.valid) >= 0.99
        assert agreement(ours.success, theirs.success) >= 0.97
    ours, theirs = (np.concatenate(each).view(np.recarray) for each in zip(*files, strict=True))
    assert agreement(ours.success, theirs.success, ours.success | theirs.success) >= 0.85
    either = (ours.fitness >= 1) | (theirs.fitness >= 1)
    assert either.sum() < FEW or agreement(ours.fitness, theirs.fitness, either) >= FITNESS[hand]
