"""`qdgrasp verify`: what it refuses before anything is started."""

from pathlib import Path

from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import SceneMaker
from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app
from qdgrasp_protocol.errors import FolderError, InputError


def refusal(*arguments: object) -> BaseException | None:
    return CliRunner().invoke(app, ["verify", *map(str, arguments)]).exception


def test_all_rows_leave_nothing_to_a_sample(tmp_path: Path) -> None:
    refused = refusal(tmp_path, "--all", "--sample", 3)
    assert isinstance(refused, InputError)
    assert str(refused) == "--all leaves nothing to --sample: give one of them."


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    assert isinstance(refusal(tmp_path), FolderError)


def test_a_run_without_rows_is_refused(tmp_path: Path, make_scene: SceneMaker) -> None:
    empty = record(tmp_path / "empty", make_scene(), random_rows(0))
    refused = refusal(empty.path)
    assert isinstance(refused, InputError)
    assert str(refused) == "Nothing is recorded there that could be evaluated again."
