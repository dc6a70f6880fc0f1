"""Fixtures: commands in a folder of their own, and a run to compare with."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.system.commands import LONG, Commands


@pytest.fixture
def qdgrasp(tmp_path: Path) -> Iterator[Commands]:
    commands = Commands(tmp_path)
    yield commands
    commands.end_all()


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, dict]:
    """An undisturbed run: its folder, digest and figures."""
    home = tmp_path_factory.mktemp("reference")
    commands = Commands(home)
    done = commands("run", *LONG, "--workers", 1, "--out", "run")
    assert done.code == 0, done.err
    return home / "run", commands.digest("run"), commands.info("run")


@pytest.fixture(scope="session")
def long_digest(reference: tuple[Path, str, dict]) -> str:
    """What a run is to have in the end that was disturbed."""
    return reference[1]
