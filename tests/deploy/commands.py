"""The command lines in deploy/, held to the commands that there are."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import typer

import qdgrasp_coordinator.cli.coordinator_process
import qdgrasp_coordinator.cli.main
import qdgrasp_coordinator.cli.monitor_process
import qdgrasp_coordinator.cli.recorder_process
import qdgrasp_coordinator.cli.router_process
import qdgrasp_worker.cli

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
COMMANDS = {
    "qdgrasp": qdgrasp_coordinator.cli.main.app,
    "qdgrasp-coordinator": qdgrasp_coordinator.cli.coordinator_process.app,
    "qdgrasp-monitor": qdgrasp_coordinator.cli.monitor_process.app,
    "qdgrasp-recorder": qdgrasp_coordinator.cli.recorder_process.app,
    "qdgrasp-router": qdgrasp_coordinator.cli.router_process.app,
    "qdgrasp-worker": qdgrasp_worker.cli.app,
}


def understood(words: Sequence[str]) -> dict[str, Any]:
    """What a command makes of its arguments, by their names, without doing anything.

    Raises
    ------
    KeyError
        There is no such command.
    click.UsageError
        It has no such option or argument, or does not take this value.
    """
    name, *arguments = words
    command: Any = typer.main.get_command(COMMANDS[Path(name).name])
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    return dict(command.make_context(name, arguments).params)


def filled(line: str, values: Mapping[str, str]) -> list[str]:
    """The words of a command line once its variables have their values.

    Raises
    ------
    KeyError
        A variable has none.
    """
    return [Template(word).substitute(values) for word in shlex.split(line)]
