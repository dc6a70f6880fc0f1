"""What commands say that read a folder where none is: the same, whichever it is."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app
from qdgrasp_protocol.errors import NoFolder

READERS = {
    "info": (),
    "digest": (),
    "show": ("--grasp", "0"),
    "view": ("--no-open",),
    "export": ("--format", "csv", "--out", "never"),
    "render": ("--grasp", "0", "--out", "never.png"),
    "verify": (),
    "prune": (),
    "resume": (),
    "rerank": ("--top", "1"),
}


def refusal(command: str, path: Path) -> str:
    error = CliRunner().invoke(app, [command, str(path), *READERS[command]]).exception
    assert isinstance(error, NoFolder), (command, error)
    return str(error)


@pytest.mark.parametrize("command", READERS)
def test_a_folder_that_is_not_there_and_a_file_are_told_apart(command: str, tmp_path: Path) -> None:
    nowhere, file = tmp_path / "nowhere", tmp_path / "run.sqlite"
    file.write_bytes(b"")
    assert refusal(command, nowhere) == (
        f"There is no folder {nowhere}; `qdgrasp run --out {nowhere}` would begin a run there."
    )
    assert refusal(command, file) == f"{file} is no folder; name that of a run."
    assert list(tmp_path.iterdir()) == [file]
