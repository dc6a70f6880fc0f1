"""Sentences of commands, and exit codes of impossible command lines and of signals."""

import os
import signal
import subprocess
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import pytest
import typer
from tests.common import PATIENCE
from typer.exceptions import TyperException

from qdgrasp_protocol.cli_support import echo, usage_error
from qdgrasp_protocol.process import SUPERVISED


class Part(StrEnum):
    ALL = "all"
    SOME = "some"


app = typer.Typer()
inner = typer.Typer(no_args_is_help=True)
app.add_typer(inner, name="hand")


@app.command()
def show(
    grasp: Annotated[int, typer.Option(min=0)],
    offset: Annotated[float, typer.Option(min=0)] = 0.0,
    part: Part = Part.ALL,
) -> None:
    """Do nothing."""


@inner.command()
def new(name: str) -> None:
    """Do nothing, with another name."""


def said(*words: str) -> str:
    with pytest.raises(TyperException) as raised:
        app(words, prog_name="program", standalone_mode=False)
    return usage_error(raised.value, "program")


VANISHED = """
import sys, pathlib, typer
from qdgrasp_protocol.cli_support import run_command
app = typer.Typer()

@app.command()
def read(path: pathlib.Path):
    path.unlink()
    path.read_text()

sys.argv = ["program", *sys.argv[1:]]
run_command(app, "program")
"""


@pytest.mark.parametrize("is_supervised", [False, True])
def test_a_file_that_vanishes_is_a_sentence_unless_the_process_is_to_be_started_again(
    tmp_path: Path, is_supervised: bool
) -> None:
    (tmp_path / "file").touch()
    environment = {**os.environ, **({SUPERVISED: "1"} if is_supervised else {})}
    command = [sys.executable, "-c", VANISHED, str(tmp_path / "file")]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, check=False, env=environment
    )
    if is_supervised:
        assert (done.returncode, "FileNotFoundError" in done.stderr) == (1, True)
    else:
        assert done.returncode == 2
        assert done.stderr.startswith(f"program: {tmp_path / 'file'} was deleted or moved meanwhile")


@pytest.mark.parametrize("words", [["--help"], ["asset", "list"]])
def test_a_full_disk_under_standard_output_is_a_sentence(words: list[str]) -> None:
    command = [sys.executable, "-m", "qdgrasp", *words]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=PATIENCE, check=False
        )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "is full: make room" in done.stderr


LEAST = "it must be greater than or equal to 0"


@pytest.mark.parametrize(
    ("words", "fault", "command"),
    [
        ("show --grasp -1", f"Invalid value for '--grasp': {LEAST}", "program show"),
        ("show --grasp 1 --offset nan", f"Invalid value for '--offset': {LEAST}", "program show"),
        (
            "show --grasp 1 --part foo",
            "Invalid value for '--part': 'foo' is not one of 'all', 'some'",
            "program show",
        ),
        ("show", "Missing option '--grasp'", "program show"),
        ("hand new", "Missing argument 'name'", "program hand new"),
        ("hand foo", "No such command 'foo'", "program hand"),
        ("foo", "No such command 'foo'", "program"),
    ],
)
def test_a_sentence_says_what_is_wrong_and_which_help_tells_more(words, fault, command) -> None:
    assert said(*words.split()) == f"{fault}. See `{command} --help`."


DEAF = """
import ctypes, signal
import typer
from qdgrasp_protocol import cli_support as commands
app = typer.Typer()
commands.SIGNAL_GRACE = 0.3
@app.command()
def command() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    print("ready", flush=True)
    ctypes.CDLL(None).sleep(3600)
commands.run_command(app, "deaf")
"""


def signalled(code: str, number: int) -> tuple[int, str, str]:
    """The exit of a program that is sent a signal as soon as it is ready."""
    command = [sys.executable, "-c", code]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0
    ) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_in_a_call_that_hears_nothing_is_ended_by_force(number: int) -> None:
    assert signalled(DEAF, number) == (128 + number, "", "")


def test_what_is_printed_keeps_its_lines_and_nothing_else_that_a_terminal_obeys(capsys) -> None:
    echo("one\r\x1b[1A\ntwo\x9b2J\u202e \ud800 é")
    echo("three\x07", err=True)
    assert capsys.readouterr() == ("one\\r\\x1b[1A\ntwo\\x9b2J\\u202e \\ud800 é\n", "three\\x07\n")
