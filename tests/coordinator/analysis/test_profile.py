"""Everything known about one row."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import SceneMaker

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import FreeJoint, Scene, Synergy
from qdgrasp_coordinator.analysis.profile import NoSuchRow, profile
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

METHOD, PRIOR = "me_scs", "spherical"
OUTCOMES = [Outcome.OVERLAP, Outcome.HELD, Outcome.DEAD_END, Outcome.SHAKEN, Outcome.MISSED]


@dataclass
class Made:
    scene: Scene
    rows: Rows
    folder: RunFolder


@pytest.fixture
def made(tmp_path: Path, make_scene: SceneMaker) -> Made:
    return run_of(tmp_path / "mug", make_scene(), OUTCOMES)


def run_of(path: Path, scene: Scene, outcomes: list[Outcome], **settings: str) -> Made:
    """A run that recorded nominal rows with these outcomes; those with a pose stand at (1, 2, 3) cm."""
    rows = Shape(len(layout(scene, PRIOR)), 2).empty(len(outcomes))
    rows["index"], rows["outcome"] = np.arange(len(rows)), outcomes
    rows["fitness"] = np.clip(rows["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    rows["genome"] = np.linspace(-1, 1, rows["genome"].size).reshape(rows["genome"].shape)
    posed = rows["outcome"] >= Outcome.OVERLAP
    rows["base_to_object"][posed] = (0.01, 0.02, 0.03, 0, 0, 0, 1)
    rows["descriptor"] = rows["base_to_object"][:, :3]
    rows["joints"] = (0.01, 0.02)
    return Made(scene, rows, record(path, scene, rows, method=METHOD, **settings))


def test_a_row_is_told_as_it_was_recorded(made: Made) -> None:
    found = profile(made.folder, 1)
    assert (found.number, found.rows, found.generation, found.index, found.trial) == (1, 5, 0, 1, 0)
    assert (found.outcome, found.fitness, found.cell) == ("held", 2.0, (1, 2, 3))
    assert (found.method, found.prior, found.gripper, found.protocol) == (METHOD, PRIOR, "jaw", "paper")
    assert found.scene == made.folder.bundle().digest


def test_a_pose_says_its_frame_and_the_order_of_its_quaternion(made: Made) -> None:
    pose = profile(made.folder, 1).base_to_object
    assert pose is not None
    assert (pose.link, pose.frame) == ("palm", "object's centre-of-mass frame")
    assert pose.position == pytest.approx((0.01, 0.02, 0.03))
    assert pose.quaternion_xyzw == (0, 0, 0, 1)


def test_joints_have_names_and_units(made: Made) -> None:
    joints = profile(made.folder, 1).joints
    assert [(one.name, round(one.position, 6), one.unit) for one in joints] == [
        ("left", 0.01, "m"),
        ("right", 0.02, "m"),
    ]


def test_a_joint_that_turns_is_told_in_radians(tmp_path: Path, make_scene: SceneMaker) -> None:
    scene = make_scene()
    urdf = scene.gripper.urdf.replace("prismatic", "revolute")
    hand = msgspec.structs.replace(scene.gripper, urdf=urdf)
    turning = run_of(tmp_path / "mug", msgspec.structs.replace(scene, gripper=hand), OUTCOMES)
    assert {one.unit for one in profile(turning.folder, 1).joints} == {"rad"}


def test_genes_have_names_and_stand_for_values_in_their_intervals(made: Made) -> None:
    genes = profile(made.folder, 1).genome
    known = layout(made.scene, PRIOR)
    assert tuple(one.name for one in genes) == known.names
    assert [one.value for one in genes] == pytest.approx(known.values(made.rows["genome"][[1]])[0])


def test_what_there_is_not_is_left_out(made: Made) -> None:
    dead, missed = profile(made.folder, 2), profile(made.folder, 4)
    assert (dead.base_to_object, dead.cell, dead.joints) == (None, None, ())
    assert (missed.surface_point, missed.nu, missed.eta, missed.synergy) == (None, None, None, "")


def test_the_synergy_is_told_by_its_name(tmp_path: Path, make_scene: SceneMaker) -> None:
    scene = make_scene()
    hand = msgspec.structs.replace(
        scene.gripper,
        synergies=(Synergy(name="one", joints=("left",)), Synergy(name="both", joints=("left", "right"))),
        free_joints=(FreeJoint(name="left", low=0.0, high=0.04),),
    )
    closing = run_of(tmp_path / "mug", msgspec.structs.replace(scene, gripper=hand), OUTCOMES)
    assert [profile(closing.folder, number).synergy for number in (0, 4)] == ["one", "both"]


@pytest.mark.parametrize("missing", [0, 1])
def test_eta_is_told_once_all_trials_are_there(tmp_path: Path, make_scene: SceneMaker, missing: int) -> None:
    made = run_of(tmp_path / "plain", make_scene(), OUTCOMES)
    trials = np.repeat(made.rows[[1, 3]], 100)
    trials["trial"] = np.tile(np.arange(1, 101), 2)
    trials["fitness"] = np.repeat([1, 0], 100)
    rows = np.concatenate([made.rows, trials[: len(trials) - missing]])
    folder = record(tmp_path / "mug", made.scene, rows, method=METHOD, protocol="robust")
    held, shaken = profile(folder, 1), profile(folder, 3)
    assert (held.trials, held.eta) == (100, 0.5)
    assert (shaken.trials, shaken.eta) == (100 - missing, None if missing else 0.0)
    assert profile(folder, 5).trial == 1


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        (OUTCOMES, "has no row 7: it has 5, numbered from 0, and the nearest success is 3."),
        (OUTCOMES[:1], "has no row 7: it has 1, numbered from 0, none of them a success."),
        ([], "has no row 7: it has none yet."),
    ],
)
def test_a_number_that_no_row_has_is_refused_with_the_nearest(
    tmp_path: Path, make_scene: SceneMaker, outcomes: list[Outcome], words: str
) -> None:
    with pytest.raises(NoSuchRow, match=words):
        profile(run_of(tmp_path / "mug", make_scene(), outcomes).folder, 7)


def test_a_person_reads_every_field(made: Made) -> None:
    for number in range(len(OUTCOMES)):
        table = profile(made.folder, number).table
        for name in ("outcome", "descriptor", "base to object", "nu", "genome", "scene", "generation", "eta"):
            assert f"\n{name:<16} " in table
    assert "of link 'palm' in the object's centre-of-mass frame" in profile(made.folder, 1).table
