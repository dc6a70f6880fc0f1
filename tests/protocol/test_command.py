"""What every command does alike when it is asked to stop."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.patience import PATIENCE

DEAF = """
import ctypes, signal
import typer
from qdgrasp_protocol import command as commands
app = typer.Typer()
commands.PATIENCE = 0.3
@app.command()
def command() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    print("ready", flush=True)
    ctypes.CDLL(None).sleep(3600)
commands.run_command(app, "deaf")
"""
LIVING = """
import time
import typer
from qdgrasp_protocol import command as commands
from qdgrasp_protocol.lifetime import lifetime
app = typer.Typer()
commands.PATIENCE = 0.3
@app.command()
def command() -> None:
    with lifetime("living") as stop:
        print("ready", flush=True)
        while not stop.is_set:
            time.sleep(0.01)
        time.sleep(1.0)
        print("done", flush=True)
    raise typer.Exit(stop.exit_code)
commands.run_command(app, "living")
"""


def signalled(code: str, number: int) -> tuple[int, str, str]:
    """How a program ends that is sent a signal as soon as it is ready."""
    command = [sys.executable, "-c", code]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_in_a_call_that_hears_nothing_is_ended_by_force(number: int) -> None:
    assert signalled(DEAF, number) == (128 + number, "", "")


def test_a_command_that_takes_its_time_to_stop_in_order_is_left_to_it() -> None:
    assert signalled(LIVING, signal.SIGTERM) == (128 + signal.SIGTERM, "done\n", "")


EXECUTING = """
import signal
import typer
from qdgrasp_protocol.command import run_command
app = typer.Typer()
@app.command()
def command() -> None:
    exec("signal.raise_signal({number})")
run_command(app, "executing")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_within_a_text_that_is_executed_has_its_exit_code_too(number: int, tmp_path: Path) -> None:
    (tmp_path / "executing.py").write_text(EXECUTING.format(number=int(number)))
    command = [sys.executable, "-m", "executing"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", "")
