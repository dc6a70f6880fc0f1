"""Where the commands begin."""

import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

from qdgrasp import entry

SCRIPTS = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]["scripts"]


@pytest.mark.parametrize("script", SCRIPTS.values(), ids=SCRIPTS)
def test_every_command_begins_before_anything_is_loaded(script: str) -> None:
    module, _, name = script.partition(":")
    assert module == "qdgrasp.entry"
    assert callable(getattr(entry, name))


def test_the_beginning_loads_no_package() -> None:
    code = "import sys; before = set(sys.modules); import qdgrasp.entry; print(*(set(sys.modules) - before))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout
    assert not {name.partition(".")[0] for name in loaded.split()} & {"numpy", "typer", "zenoh", "rich"}


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_command_answers_for_help(name: str) -> None:
    function = SCRIPTS[name].partition(":")[2]
    code = f"import sys; sys.argv = [{name!r}, '--help']; from qdgrasp.entry import {function} as f; f()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    assert f"Usage: {name}" in done.stdout


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_command_says_its_version(name: str) -> None:
    function = SCRIPTS[name].partition(":")[2]
    code = f"import sys; sys.argv = [{name!r}, '--version']; from qdgrasp.entry import {function} as f; f()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, text=True)
    assert (done.returncode, done.stdout) == (0, f"{name} {version('qdgrasp')}\n"), done.stderr


def test_a_command_without_a_word_behind_it_shows_its_help() -> None:
    done = subprocess.run([sys.executable, "-m", "qdgrasp"], capture_output=True, check=False, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("Usage: qdgrasp [OPTIONS] COMMAND")
