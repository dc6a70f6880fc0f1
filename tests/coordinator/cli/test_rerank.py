"""`qdgrasp rerank`: what it takes from a run, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.cli.main import app
from qdgrasp_coordinator.cli.rerank import spec_of
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.folders.journal_writer import JournalWriter
from qdgrasp_coordinator.searches.search import check
from qdgrasp_protocol.errors import FolderError, InputError
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import RunSpec, to_toml

SPEC = RunSpec(gripper="panda", object="tennis_ball", mass=0.07, method="contact_me_scs", seed=5)


@pytest.fixture
def source(tmp_path: Path) -> RunFolder:
    """A run that has recorded a success, and no grasp."""
    scene = build_scene(SPEC)
    bundle = pack_scene(scene)
    folder = RunFolder.create(tmp_path / "source", SPEC, bundle)
    shape = Shape(len(layout(scene, "contact")), len(scene.gripper.joints))
    rows = shape.empty(3)
    rows["index"], rows["outcome"] = np.arange(3), [Outcome.OVERLAP, Outcome.DROPPED, Outcome.MISSED]
    rows["base_to_object"][:, 6] = 1
    with JournalWriter.create(folder.path, Identity("run", to_toml(SPEC), bundle.digest, shape)) as journal:
        journal.append(Stretch(0, rows), 1, 0.0)
    return folder


def rerank(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["rerank", *map(str, arguments)])


def test_a_run_without_a_grasp_has_nothing_to_score_again(source: RunFolder, tmp_path: Path) -> None:
    refused = rerank(source.path, "--out", tmp_path / "again").exception
    assert isinstance(refused, InputError)
    assert "has found no grasp (fitness 1 or more)" in str(refused)
    assert not (tmp_path / "again").exists()


def test_a_folder_that_holds_a_run_is_never_written_over(source: RunFolder) -> None:
    refused = rerank(source.path, "--out", source.path).exception
    assert isinstance(refused, FolderError)
    assert "holds a run already" in str(refused)


def test_the_spec_keeps_the_scene_and_takes_each_pose_once(source: RunFolder) -> None:
    with source.journal() as journal:
        chosen: Rows = journal.rows(0, 3)
    spec = spec_of(source, "robust", chosen)
    check(spec)
    assert (spec.gripper, spec.object, spec.mass, spec.seed) == ("panda", "tennis_ball", 0.07, 5)
    assert (spec.method, spec.protocol, spec.evaluations, spec.population) == ("given", "robust", 3, 3)
    assert spec.poses == ((0, 0, 0, 0, 0, 0, 1),) * 3
