"""The command lines in deploy/, held to the commands that there are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from qdgrasp_tools.cli import job_commands, job_processes, main
from qdgrasp_worker import cli

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
COMMANDS = {
    "qdgrasp": main.app,
    "qdgrasp-monitor": job_commands.monitor_app,
    "qdgrasp-worker": cli.app,
    **{f"qdgrasp-{name}": app for name, app in job_processes.APPS.items()},
}


def understood(words: Sequence[str]) -> dict[str, Any]:
    """Return the arguments as a command reads them, by name, without doing anything.

    Raises KeyError if there is no such command, and click.UsageError if it does not take such an argument.
    """
    name, *arguments = words
    command: Any = typer.main.get_command(COMMANDS[Path(name).name])
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    return dict(command.make_context(name, arguments).params)
