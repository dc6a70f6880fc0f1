"""Poses in a spec, each asked once."""

import msgspec
import numpy as np
import pytest
from tests.coordinator.scenes import made_scene
from tests.coordinator.search.synthetic_scene import plain

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_coordinator.metrics.cells import GenomeReader
from qdgrasp_coordinator.metrics.successes import TrialPlan
from qdgrasp_coordinator.search.fixed_poses import as_given, read_poses, scores, write_scores
from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.rows import GIVEN, Outcome, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import Decoder

SPEC_POSES = tuple(
    tuple(float(str(x)) for x in row) for row in np.random.default_rng(2).normal(size=(7, 9)).astype("f4")
)
SPEC = RunSpec(gripper="panda", object="mug", method="given", poses=SPEC_POSES, evaluations=7, population=3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"evaluations": 8}, "at most 7, one for each pose"),
        ({"poses": (*SPEC_POSES[:6], (*SPEC_POSES[6][:8], float("inf")))}, "finite"),
        ({"poses": (*SPEC_POSES[:6], (*SPEC_POSES[6][:8], 1e300))}, "finite"),
        ({"poses": (*SPEC_POSES[:6], SPEC_POSES[6][:8])}, "lists of 9 numbers"),
    ],
)
def test_poses_that_cannot_be_scored_are_refused(change: dict, words: str) -> None:
    with pytest.raises(ImpossibleValue, match=words):
        method("given").build(msgspec.structs.replace(SPEC, **change), plain(9))


ERRORS = {"synergy": "synergies", "spread": "spreads"}  # Arrays of a file as errors call them
POSES = {
    "base_position": np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0]]),
    "base_quaternion_xyzw": np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0]]),
}


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"base_position": np.zeros((2, 2))}, "positions must be numbers of shape (n, 3), got (2, 2)"),
        ({"base_position": np.zeros((3, 3))}, "quaternions_xyzw must be numbers of shape (3, 4), got (2, 4)"),
        ({"base_position": np.zeros((2, 3), complex)}, "its type is complex128"),
        ({"base_position": np.full((2, 3), 1e30)}, "no more than 1000 m away; in metres, got 1e+30"),
        ({"base_position": np.full((2, 3), np.nan)}, "no more than 1000 m away"),
        ({"base_quaternion_xyzw": np.zeros((2, 4))}, "length zero"),
        ({"synergy": np.array(["thumb", "index"])}, "synergies"),
        *(({"synergy": np.array([x, 0.0])}, "synergies must be integers, got") for x in (np.inf, 0.5, 1e300)),
        ({"spread": np.zeros(2)}, "spreads must be numbers of shape (2, k), got (2,)"),
        ({"spread": np.full((2, 2), np.inf)}, "spreads must be within 1000 rad or m of 0, got inf"),
        ({"base_position": np.zeros((0, 3)), "base_quaternion_xyzw": np.zeros((0, 4))}, "no poses"),
    ],
)
def test_arrays_that_cannot_be_are_named(tmp_path, change, words):
    with pytest.raises(InputError, match=r".") as raised:
        read_poses(saved(tmp_path / "poses.npz", **(POSES | change)))
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("hand", "name", "values", "words"),
    [
        ("panda", "synergy", [9, 0], "must be -1, for the hand has none, got 9"),
        ("panda", "synergy", [-2, -1], "must be -1, for the hand has none, got -2"),
        ("allegro", "synergy", [3, 4], "must be -1 (none) or 0 to 3 for this hand, got 4"),
        ("panda", "spread", [[np.nan], [0.3]], "must be NaN, for the hand has no free joints"),
        ("barrett", "spread", [[0.3] * 3] * 2, "must be NaN but in the first 2 columns, got 0.3"),
    ],
)
def test_what_a_hand_does_not_have_is_asked_of_no_hand(tmp_path, hand, name, values, words):
    poses = read_poses(saved(tmp_path / "poses.npz", **POSES, **{name: np.array(values)}))
    scene = build_scene(RunSpec(gripper=hand, object="tennis_ball"))
    with pytest.raises(InputError) as raised:
        poses.genomes(scene)
    assert f"{tmp_path / 'poses.npz'}: {ERRORS[name]} {words}" in str(raised.value)


def test_labels_and_free_joints_that_are_not_said_stand_for_the_open_hand_and_all_its_joints(tmp_path):
    silent = {"synergy": np.full(2, np.nan), "spread": np.full((2, 3), np.nan)}
    scene = build_scene(RunSpec(gripper="barrett", object="tennis_ball"))
    plain, said = (
        read_poses(saved(tmp_path / name, **POSES, **asked)).genomes(scene)
        for name, asked in {"plain.npz": {}, "said.npz": silent}.items()
    )
    assert plain.tobytes() == said.tobytes()


def test_scores_are_false_and_zero_for_overlaps(tmp_path):
    rows, body = RowShape(genes=7, joints=2, contact_slots=3).empty(3), made_scene().object
    rows["outcome"] = [Outcome.OVERLAP, Outcome.BRUSHED, Outcome.HELD]
    rows["fitness"] = [0, 0, 2]
    rows["base_to_object"][:, 6] = 1.0
    rows["settled"][2] = (0.003, 0.0, 0.004, 0.0, 0.0, 0.0, 1.0)
    rows["contact_links"][2, 0], rows["contact_points"][2, :7] = 2, (0.01, 0.0, 0.0, -1.0, 0.0, 0.0, 5.0)
    found = scores(rows, body)
    assert found["valid"].tolist() == [False, True, True]
    assert found["touched"].tolist() == [False, True, True]
    assert found["success"].tolist() == [False, False, True]
    assert found["fitness"].tolist() == [0, 0, 2]
    assert found["fitness"].dtype == np.uint8
    np.testing.assert_allclose(found["settled_position"], [[np.nan] * 3] * 2 + [[0.003, 0.0, 0.004]])
    np.testing.assert_allclose(found["motion"], [[np.nan] * 2] * 2 + [[0.005, 0.0]], atol=1e-7)
    assert np.isnan(found["margin"]).tolist() == [True, True, False]
    assert found["contact_links"].tolist() == [[-1] * 3] * 2 + [[1, -1, -1]]
    assert (found["contact_points"][2, 0, 0], found["contact_forces"][2, 0]) == pytest.approx(
        (0.01, 5.0), rel=1e-3
    )
    write_scores(tmp_path / "scores.npz", rows, body)
    with np.load(tmp_path / "scores.npz", allow_pickle=False) as file:
        assert set(file.files) == set(found)


@pytest.mark.parametrize("prior", ["contact", "spherical"])
@pytest.mark.parametrize("hand", ["panda", "barrett", "shadow"])
def test_rows_as_given_poses_decode_to_the_very_same_grasps(hand: str, prior: str) -> None:
    """Bit for bit, so that their trials are disturbed in the same way; and so once more."""
    scene, random = build_scene(RunSpec(gripper=hand, object="tennis_ball")), np.random.default_rng(3)
    surface = ObjectSurface(scene)
    genomes = random.uniform(-1, 1, (200, len(layout(scene, prior)))).astype(np.float32)
    expected = Decoder(scene, prior, surface)(genomes)
    for known in (prior, GIVEN):
        rows = RowShape(genomes.shape[1], len(scene.gripper.joints)).empty(200)
        rows["genome"] = genomes
        rows["base_to_object"] = np.hstack([expected.positions, expected.quaternions])
        assert GenomeReader.of(scene, known).postures(rows).tobytes() == expected.joints.tobytes()
        genomes = as_given(scene, known, rows)
        found = Decoder(scene, GIVEN, surface)(genomes)
        for column in ("positions", "quaternions", "joints", "synergies"):
            assert getattr(found, column).tobytes() == getattr(expected, column).tobytes()


def test_scores_of_poses_in_trials_tell_their_eta() -> None:
    rows = RowShape(genes=7, joints=2, contact_slots=1).empty(6)
    rows["index"], rows["trial"] = [0, 1, 2, 1, 1, 1], [0, 0, 0, 1, 2, 3]
    nominal = [Outcome.MISSED, Outcome.HELD, Outcome.OVERLAP]
    rows["outcome"] = [*nominal, Outcome.HELD, Outcome.SHAKEN, Outcome.ERROR]
    rows["fitness"] = [0, 2, 0, 2, 1, 0]
    body = made_scene().object
    found = scores(rows, body, TrialPlan(3))
    assert found["eta"].tolist() == [0, 0.5, 0]
    assert found["success"].tolist() == [False, True, False]
    assert "eta" not in scores(rows[:3], body)
