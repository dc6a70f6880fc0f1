"""Entry points of the commands, and the modules that they load first."""

import json
import re
import signal
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from typer.testing import CliRunner

from qdgrasp_protocol.spec import key_texts
from qdgrasp_tools.cli import job_processes, main

HEAVY = {"embreex", "matplotlib", "numba", "ribs", "scipy", "sklearn", "trimesh"}
"""Packages that take a tenth of a second or more to import; commands import them where needed."""


@pytest.mark.parametrize("module", ["main", "job_processes"])
def test_a_command_line_loads_nothing_heavy_before_its_command_runs(module):
    statements = f"import json, sys, qdgrasp_tools.cli.{module}; print(json.dumps(sorted(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", statements], capture_output=True, check=True, text=True)
    assert not HEAVY & set(json.loads(said.stdout))


@pytest.mark.parametrize("flags", [["--listen", "tcp/127.0.0.1:0"], ["--insecure"]])
def test_a_coordinator_at_routers_that_run_has_no_flags_of_its_own_router(flags: list[str]) -> None:
    asked = ["spec.toml", "--connect", "tcp/127.0.0.1:7447", *flags]
    refusal = CliRunner().invoke(job_processes.APPS["coordinator"], asked).exception
    assert "--listen and --insecure are for an embedded router" in str(refusal)


SCRIPTS = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]["scripts"]


DISTURBED = """
import atexit, signal, sys
function, moment, number = sys.argv[1], sys.argv[2], int(sys.argv[3])
del sys.argv[1:4]
class Disturber:
    def find_spec(self, name, path=None, target=None):
        if name == moment:
            signal.raise_signal(number)
sys.meta_path.insert(0, Disturber())
if moment == "the end":
    atexit.register(signal.raise_signal, number)
from qdgrasp import entry
getattr(entry, function)()
"""
"""A command that is sent a signal when it begins to load a module, or when Python ends."""
FIRST, WITHIN = "typer", "qdgrasp_tools.export.exporter"
EXPORT = ("export", "run", "--format", "csv", "-o", "out.csv")


@pytest.mark.parametrize(
    ("script", "moment", "words"),
    [*((name, FIRST, ()) for name in SCRIPTS), ("qdgrasp", WITHIN, EXPORT), ("qdgrasp", "the end", ())],
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_a_signal_leaves_no_trace_whatever_is_being_loaded(script, moment, words, number) -> None:
    function = SCRIPTS[script].partition(":")[2]
    asked = (function, moment, str(int(number)), *(words or ["--version"]))
    done = subprocess.run(
        [sys.executable, "-c", DISTURBED, *asked], capture_output=True, check=False, text=True
    )
    assert (done.returncode, done.stderr) == (128 + number, "")


def answer(name: str, flag: str) -> str:
    """Run a command with a flag; returns its output."""
    function = SCRIPTS[name].partition(":")[2]
    code = f"import sys; sys.argv = [{name!r}, {flag!r}]; from qdgrasp.entry import {function} as f; f()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_command_answers_for_help_and_says_its_version(name: str) -> None:
    assert f"Usage: {name}" in answer(name, "--help")
    assert answer(name, "--version") == f"{name} {version('qdgrasp')}\n"


def test_the_help_of_a_run_has_the_flags_people_type_and_all_other_keys_for_set() -> None:
    shown = CliRunner().invoke(main.app, ["run", "--help"]).output
    flags = set(re.findall(r"^│ --(\S+)", shown, re.MULTILINE)) - {"help"}
    keys = re.findall(r"^  • (\w+):", shown, re.MULTILINE)
    assert len(flags) <= 22
    named = {flag.replace("-", "_").replace("units", "scale") for flag in flags}
    assert set(keys) | named >= key_texts().keys()
    assert not named & set(keys)
