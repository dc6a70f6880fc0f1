"""`qdgrasp prune`: what it says of the room that it made."""

from pathlib import Path

import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import SceneMaker
from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app


@pytest.mark.parametrize(("rows", "words"), [(60, "Hardly any room is free; "), (6000, " MB are free; ")])
def test_room_is_told_where_there_is_some(
    tmp_path: Path, make_scene: SceneMaker, rows: int, words: str
) -> None:
    folder = record(tmp_path / "run", make_scene(), random_rows(rows), evaluations=rows)
    done = CliRunner().invoke(app, ["prune", str(folder.path)])
    assert done.exit_code == 0, done.output
    assert f"{words}{folder.path} keeps successes alone." in done.stdout
    assert "0.0" not in done.stdout
