"""`qdgrasp security`: its folders and refusals."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from qdgrasp_protocol.errors import OutputError
from qdgrasp_tools.cli import machine_commands


def run(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(machine_commands.security_app, [*map(str, arguments)])
    if isinstance(done.exception, OutputError):
        raise done.exception
    return done.exit_code, done.output


def test_init_writes_a_folder_and_add_another_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "security"
    code, said = run("init", folder, "--host", "head", "--days", 7)
    assert (code, "qdgrasp-router --listen tls/" in said) == (0, True)
    code, said = run("add", folder, "worker", "lab-7")
    assert (code, str(folder / "lab-7") in said) == (0, True)
    assert (folder / "lab-7" / "worker.key").is_file()
    with pytest.raises(OutputError, match="or add to it with `qdgrasp security add"):
        run("init", folder)
