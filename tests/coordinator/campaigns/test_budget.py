"""Which budgets a run that has begun may be given."""

from pathlib import Path

import numpy as np
import pytest

from qdgrasp_coordinator.campaigns.budget import extend
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.folders.journal_writer import JournalWriter
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import RunSpec, to_toml

SHAPE = Shape(genes=7, joints=2)


def begun(path: Path, spec: RunSpec, rows: Rows) -> RunFolder:
    """A run that has recorded these rows."""
    folder = RunFolder.create(path / "run", spec, None)
    with JournalWriter.create(folder.path, Identity("run", to_toml(spec), "0" * 64, SHAPE)) as journal:
        journal.append(Stretch(0, rows), 1, 0.0)
    return folder


def generation(size: int) -> Rows:
    """Nominal rows with a success at the beginning, and its hundred trials."""
    rows = SHAPE.empty(size + 100)
    rows["index"][:size], rows["trial"][size:] = np.arange(size), np.arange(1, 101)
    rows["outcome"] = Outcome.MISSED
    rows["outcome"][0] = Outcome.HELD
    return rows


def test_a_budget_is_raised_and_not_taken_back_below_what_is_recorded(tmp_path: Path) -> None:
    spec = RunSpec(gripper="hand", object="thing", evaluations=10, population=8)
    folder = begun(tmp_path, spec, generation(6)[:6])
    extend(folder, evaluations=30)
    assert folder.spec.evaluations == 30
    with pytest.raises(ImpossibleValue, match="at least 6, which are recorded"):
        extend(folder, evaluations=5)
    assert folder.spec.evaluations == 30


def test_a_run_whose_trials_end_a_generation_early_keeps_its_budget(tmp_path: Path) -> None:
    spec = RunSpec(gripper="hand", object="thing", protocol="robust", evaluations=6, population=8)
    folder = begun(tmp_path, spec, generation(6))
    extend(folder, evaluations=6)
    with pytest.raises(ImpossibleValue, match="only whole generations can be extended"):
        extend(folder, evaluations=7)
    assert folder.spec.evaluations == 6


def test_a_run_with_trials_is_extended_from_a_whole_generation(tmp_path: Path) -> None:
    spec = RunSpec(gripper="hand", object="thing", protocol="robust", evaluations=8, population=8)
    folder = begun(tmp_path, spec, generation(8))
    extend(folder, evaluations=100)
    assert folder.spec.evaluations == 100


def test_there_are_no_more_evaluations_than_poses(tmp_path: Path) -> None:
    poses = ((0.0,) * 7,) * 8
    spec = RunSpec(gripper="hand", object="thing", method="given", poses=poses, evaluations=8, population=8)
    folder = begun(tmp_path, spec, generation(8)[:8])
    with pytest.raises(ImpossibleValue, match="at most 8, one for each pose"):
        extend(folder, evaluations=9)
