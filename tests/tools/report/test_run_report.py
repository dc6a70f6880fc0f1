"""Context of rows: the synergy that closed the hand, and the trials of a success."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from tests.common import with_gripper
from tests.coordinator.recorded_runs import record, reshape_rows
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import FreeJoint, Scene, Synergy
from qdgrasp_coordinator.metrics.cells import GenomeReader
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_tools.report.run_report import NoSuchRow, report_table, row_context, row_report

PRIORS = {"me_scs": "spherical", "contact_rand": "contact"}


SYNERGIES = tuple(Synergy(name=name, joints=("left",)) for name in ("a", "b", "c"))
CLOSING = with_gripper(made_scene(), synergies=SYNERGIES)


def run_of_synergies(path: Path, method: str = "me_scs", seed: int = 1) -> tuple[RunFolder, Rows]:
    random, genes = np.random.default_rng(seed), len(layout(CLOSING, PRIORS[method]))
    rows = RowShape(genes, 2).empty(20)
    rows["generation"], rows["index"] = np.divmod(np.arange(20), 10)
    rows["outcome"], rows["fitness"] = Outcome.HELD, 2
    rows["genome"] = random.uniform(-1, 1, rows["genome"].shape)
    rows["base_to_object"][:, :3] = rows["descriptor"] = random.uniform(-0.1, 0.1, (20, 3))
    rows["base_to_object"][:, 6] = 1
    return record(path, CLOSING, rows, method=method, seed=seed, evaluations=20), rows


def labels(folder: RunFolder) -> list[int]:
    with folder.journal() as journal:
        rows = np.concatenate(list(journal.blocks()))
        return row_context(folder, journal).genomes.labels(rows["genome"]).tolist()


def test_a_run_names_synergies_as_its_prior_does(tmp_path: Path) -> None:
    folder, rows = run_of_synergies(tmp_path / "mug")
    assert labels(folder) == GenomeReader.of(CLOSING, "spherical").labels(rows["genome"]).tolist()
    assert len(set(labels(folder))) == 3


def test_before_the_scene_is_there_no_synergy_is_named(tmp_path: Path) -> None:
    folder, rows = run_of_synergies(tmp_path / "mug")
    (folder.path / "scene.bundle").unlink()
    with folder.journal() as journal:
        found = row_context(folder, journal).genomes.labels(rows["genome"])
    assert set(found.tolist()) == {-1}


METHOD, PRIOR = "me_scs", "spherical"
OUTCOMES = [Outcome.OVERLAP, Outcome.HELD, Outcome.DEAD_END, Outcome.SHAKEN, Outcome.MISSED]


@dataclass
class Made:
    scene: Scene
    rows: Rows
    folder: RunFolder


@pytest.fixture
def made(tmp_path: Path) -> Made:
    return run_of(tmp_path / "mug", made_scene(), OUTCOMES)


def run_of(path: Path, scene: Scene, outcomes: list[Outcome], **settings: str) -> Made:
    """A run with nominal rows of these outcomes; those with a pose stand at (1, 2, 3) cm."""
    rows = RowShape(len(layout(scene, PRIOR)), 2).empty(len(outcomes))
    rows["index"], rows["outcome"] = np.arange(len(rows)), outcomes
    rows["fitness"] = np.clip(rows["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    rows["genome"] = np.linspace(-1, 1, rows["genome"].size).reshape(rows["genome"].shape)
    posed = rows["outcome"] >= Outcome.OVERLAP
    rows["base_to_object"][posed] = (0.01, 0.02, 0.03, 0, 0, 0, 1)
    rows["descriptor"] = rows["base_to_object"][:, :3]
    rows["joints"] = (0.01, 0.02)
    return Made(scene, rows, record(path, scene, rows, method=METHOD, **settings))


def test_a_row_is_told_as_it_was_recorded_with_frames_orders_names_and_units(made: Made) -> None:
    found = row_report(made.folder, 1)
    said = {
        "number": 1,
        "rows": 5,
        "generation": 0,
        "index": 1,
        "trial": 0,
        "outcome": "held",
        "fitness": 2.0,
    }
    said |= {"cell": [1, 2, 3], "method": METHOD, "prior": PRIOR, "gripper": "jaw", "protocol": "paper"}
    assert said.items() <= found.items()
    assert found["scene"] == made.folder.bundle().digest
    pose = found["base_to_object"]
    assert (pose["link"], pose["frame"]) == ("palm", "object's centre-of-mass frame")
    assert pose["position"] == pytest.approx((0.01, 0.02, 0.03))
    assert pose["quaternion_xyzw"] == [0, 0, 0, 1]
    joints = [(one["name"], round(one["position"], 6), one["unit"]) for one in found["joints"]]
    assert joints == [("left", 0.01, "m"), ("right", 0.02, "m")]


def test_a_success_is_told_with_the_pose_after_closing_the_motion_and_its_contacts(tmp_path: Path) -> None:
    old, genes = run_of(tmp_path / "old", made_scene(), OUTCOMES).rows, len(layout(made_scene(), PRIOR))
    rows = reshape_rows(old, RowShape(genes, 2, contact_slots=2))
    rows["settled"][1] = (0.01, 0.02, 0.033, 0, 0, np.sin(0.05), np.cos(0.05))
    rows["contact_links"][1] = (2, 0)
    rows["contact_points"][1, :7] = (0.01, 0, 0.02, 0, 1, 0, 12.5)
    scene = with_gripper(made_scene(), links=("palm", "left_finger", "right_finger"))
    found = row_report(record(tmp_path / "new", scene, rows, method=METHOD), 1)
    assert found["settled"]["position"] == pytest.approx((0.01, 0.02, 0.033))
    assert found["turned"] == pytest.approx(0.1, abs=1e-3)
    (contact,) = found["contact_points"]
    assert (contact["link"], contact["normal"], contact["force"]) == ("left_finger", [0, 1, 0], 12.5)
    assert contact["point"] == pytest.approx((0.01, 0, 0.02), abs=1e-4)
    assert "\ncontact points   link left_finger  point 0.01" in report_table(found)


def test_what_there_is_not_is_left_out(made: Made) -> None:
    dead, missed = row_report(made.folder, 2), row_report(made.folder, 4)
    assert (dead["base_to_object"], dead["cell"], dead["joints"]) == (None, None, [])
    assert (missed["surface_point"], missed["nu"], missed["eta"], missed["synergy"]) == (None, None, None, "")


def test_the_synergy_is_told_by_its_name(tmp_path: Path) -> None:
    joints = {"one": ("left",), "both": ("left", "right")}
    scene = with_gripper(
        made_scene(),
        synergies=tuple(Synergy(name=name, joints=closed) for name, closed in joints.items()),
        free_joints=(FreeJoint(name="left", low=0.0, high=0.04),),
    )
    closing = run_of(tmp_path / "mug", scene, OUTCOMES)
    assert [row_report(closing.folder, number)["synergy"] for number in (0, 4)] == ["one", "both"]


@pytest.mark.parametrize("missing", [0, 1])
def test_eta_is_told_once_all_trials_are_there(tmp_path: Path, missing: int) -> None:
    made = run_of(tmp_path / "plain", made_scene(), OUTCOMES)
    trials = np.repeat(made.rows[[1, 3]], 100)
    trials["trial"] = np.tile(np.arange(1, 101), 2)
    trials["fitness"] = np.arange(200) < 99
    rows = np.concatenate([made.rows, trials[: len(trials) - missing]])
    folder = record(tmp_path / "mug", made.scene, rows, method=METHOD, protocol="robust")
    held, shaken = row_report(folder, 1), row_report(folder, 3)
    assert (held["trials"], held["eta"]) == (100, 0.495)
    assert (shaken["trials"], shaken["eta"]) == (100 - missing, None if missing else 0.0)
    assert row_report(folder, 5)["trial"] == 1


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        (OUTCOMES, "has no row 7: it has 5, numbered from 0."),
        ([], "has no row 7: it has none yet."),
    ],
)
def test_a_number_that_no_row_has_is_refused(tmp_path, outcomes, words) -> None:
    with pytest.raises(NoSuchRow, match=words):
        row_report(run_of(tmp_path / "mug", made_scene(), outcomes).folder, 7)
