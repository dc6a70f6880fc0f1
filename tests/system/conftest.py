"""Fixtures: commands in a folder of their own, and a run to compare with."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.system.commands import LONG, Commands


@pytest.fixture
def qdgrasp(tmp_path: Path) -> Iterator[Commands]:
    with Commands(tmp_path) as commands:
        yield commands


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, dict]:
    """An undisturbed run: its folder, digest and figures."""
    home = tmp_path_factory.mktemp("reference")
    commands = Commands(home)
    commands.succeed("run", *LONG, "--workers", 1, "--out", "run")
    return home / "run", commands.digest("run"), commands.info("run")


@pytest.fixture(scope="session")
def long_digest(reference: tuple[Path, str, dict]) -> str:
    """The result that a disturbed run must have in the end."""
    return reference[1]
