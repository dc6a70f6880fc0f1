"""Exported and imported grasps evaluate as they did."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.tools.export.conftest import evaluate_given
from tests.tools.export.foreign_files import imported_file

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_coordinator.search.fixed_poses import read_poses
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import RESULT, Outcome, Rows
from qdgrasp_tools.export.exporter import export_grasps
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run
from qdgrasp_tools.export.importer import import_poses as read_file
from qdgrasp_tools.export.importer import object_frame

LARGEST = 1e-6
"""Greatest error of a pose [m, rad]."""
COMPARED = [column.name for column in RESULT if column.name not in ("surface_point", "nu")]
"""Columns of results without those of the aim, which given poses lack."""


def there_and_back(run: RunFolder, name: str, path: Path, **settings: str) -> np.ndarray:
    """The genomes of poses that were exported, imported, written for `evaluate` and read by it."""
    out = path / name
    export_grasps(run, out, name, GraspChoice(min_fitness=0), force=True, **settings)
    found = read_file(
        imported_file(out), find_gripper(run.spec.gripper).on_carrier("paper"), object_frame(run.spec.object)
    )
    assert found.notes == ()
    found.write(OutFile(path / "poses.npz", force=True))
    return read_poses(path / "poses.npz").genomes(run.scene())


def successes(run: RunFolder) -> Rows:
    rows = read_run(run).rows
    assert np.count_nonzero(rows["outcome"] >= Outcome.SHAKEN) > 3
    return rows


def errors(genomes: np.ndarray, rows: Rows) -> tuple[float, float]:
    """Greatest errors of poses [m, rad]."""
    positions = np.abs(genomes[:, :3] - rows["base_to_object"][:, :3])
    turns = Rotation.from_quat(genomes[:, 3:7]).inv() * Rotation.from_quat(rows["base_to_object"][:, 3:])
    return float(positions.max()), float(turns.magnitude().max())


@pytest.mark.parametrize("frame", ["mesh", "com"])
@pytest.mark.parametrize("name", ["parquet", "isaac"])
def test_parquet_and_isaac_yaml_keep_every_bit(evaluated_run, tmp_path, name, frame) -> None:
    genomes = there_and_back(evaluated_run, name, tmp_path, frame=frame)
    assert genomes.tobytes() == read_run(evaluated_run).starts.tobytes()


def test_poses_that_came_through_parquet_evaluate_to_the_same_bits(evaluated_run, tmp_path) -> None:
    genomes = there_and_back(evaluated_run, "parquet", tmp_path)
    before, after = successes(evaluated_run), evaluate_given(evaluated_run.scene(), genomes)
    for column in COMPARED:
        assert before[column].tobytes() == after[column].tobytes(), column


@pytest.mark.parametrize("name", ["acronym", "graspgen"])
def test_matrices_keep_poses_to_a_micrometre_and_a_microradian(evaluated_run, tmp_path, name) -> None:
    rows = successes(evaluated_run)
    genomes = there_and_back(evaluated_run, name, tmp_path)[: len(rows)]
    assert max(errors(genomes, rows)) < LARGEST
    np.testing.assert_array_equal(genomes[:, 7:], read_run(evaluated_run).starts[:, 7:])


@pytest.mark.slow
def test_poses_that_came_through_matrices_have_the_same_outcomes(evaluated_run, tmp_path) -> None:
    genomes = there_and_back(evaluated_run, "acronym", tmp_path)
    before = successes(evaluated_run)
    after = evaluate_given(evaluated_run.scene(), genomes[: len(before)])
    assert np.mean(before["outcome"] == after["outcome"]) >= 0.99
