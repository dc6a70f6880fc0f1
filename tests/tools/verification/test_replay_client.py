"""One row with all that it takes to carry its evaluation out again."""

from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene
from tests.tools.report.test_row_report import PRIOR, run_of

from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_tools.report.row_report import NoSuchRow
from qdgrasp_tools.verification.replay_client import NoPose, NoSuchTrial, replay_target

OUTCOMES = [Outcome.OVERLAP, Outcome.HELD, Outcome.DEAD_END, Outcome.ERROR]


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return run_of(tmp_path / "mug", made_scene(), OUTCOMES).folder


@pytest.fixture
def repeated(tmp_path: Path) -> RunFolder:
    """Two successes of a run under the protocol robust; of each three trials are recorded."""
    scene = made_scene()
    rows = RowShape(len(layout(scene, PRIOR)), 2).empty(8)
    rows["index"], rows["trial"] = (0, 1, 0, 0, 0, 1, 1, 1), (0, 0, 1, 2, 3, 1, 2, 3)
    rows["outcome"], rows["base_to_object"][:, 6] = Outcome.HELD, 1
    rows["genome"] = rows["index"][:, None] / 2
    return record(tmp_path / "robust", scene, rows, method="me_scs", protocol="robust")


def test_a_row_stands_for_its_very_pose(folder: RunFolder) -> None:
    found = replay_target(folder, 1)
    assert (found.number, found.outcome, found.trial) == (1, Outcome.HELD, 0)
    assert found.genome == pytest.approx((0.01, 0.02, 0.03, 0, 0, 0, 1))
    assert np.array(found.genome, dtype=np.float32).tobytes() == found.row["base_to_object"].tobytes()


def test_its_scene_comes_with_it(folder: RunFolder) -> None:
    found = replay_target(folder, 0)
    assert found.bundle.digest == folder.bundle().digest
    assert (found.scene.object.name, found.found_by.spec.method) == ("block", "me_scs")


def test_a_trial_is_found_by_its_number(repeated: RunFolder) -> None:
    found = replay_target(repeated, 1, trial=2)
    assert (found.number, found.trial, found.row["index"]) == (6, 2, 1)
    assert replay_target(repeated, 6).trial == 2
    assert replay_target(repeated, 6, trial=0).number == 1


def test_a_trial_that_is_not_recorded_is_refused(repeated: RunFolder) -> None:
    with pytest.raises(NoSuchTrial, match="Trial 4 of row 1 is not recorded: trials 1 to 3 are;"):
        replay_target(repeated, 1, trial=4)


def test_a_run_without_trials_has_none(folder: RunFolder) -> None:
    with pytest.raises(NoSuchTrial, match="Trial 1 of row 1 is not recorded: no trial is;"):
        replay_target(folder, 1, trial=1)


@pytest.mark.parametrize(("number", "why"), [(2, "a dead end"), (3, "its evaluation failed")])
def test_a_row_without_a_pose_is_refused(folder: RunFolder, number: int, why: str) -> None:
    with pytest.raises(NoPose, match=f"There is nothing of row {number} to show: .*{why}"):
        replay_target(folder, number)


def test_a_number_that_no_row_has_is_refused(folder: RunFolder) -> None:
    with pytest.raises(NoSuchRow):
        replay_target(folder, 4)
