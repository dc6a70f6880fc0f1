"""Golden texts of exit codes, and the names of the package."""

import enum
import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import qdgrasp
from qdgrasp_protocol.errors import Cancelled, EndedEarly, InputError, QdgraspError, TookOver

FAMILY = {
    "anything that we refuse or that fails": QdgraspError,
    "bad input or environment": InputError,
    "the job stopped before its budget": EndedEarly,
    "somebody told the coordinator to end": Cancelled,
    "another coordinator goes on": TookOver,
}
"""Errors with an exit code of their own, by what they stand for (README.md)."""
LINES = (
    "",
    "--version",
    "nonsense",
    "info --nonsense",
    "info nowhere",
    "run --gripper claw --object mug",
    "run --gripper panda --object mug --method antipodal",
    "run --gripper panda --object mug --evaluations 0",
)
"""Command lines that end at once."""


def exit_code_text() -> str:
    """The exit codes of `FAMILY`, and codes and standard error of the command lines `LINES`."""
    codes = "".join(f"{error.exit_code}  {words}\n" for words, error in FAMILY.items())
    with ThreadPoolExecutor(2) as together:
        return codes + "".join(together.map(_ended, LINES))


def name_text() -> str:
    """The names of `qdgrasp` with the arguments that they take, and the members of its classes.

    Names of arguments, whether they are named, and defaults: types are what mypy looks at.
    """
    lines = (line for name in dir(qdgrasp) if name != "__version__" for line in _told(name))
    return "\n".join(lines) + "\n"


def _ended(line: str) -> str:
    command = [sys.executable, "-m", "qdgrasp", *line.split()]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("QDGRASP_")}
    ended = subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    said = "".join(f"   {words}\n" for words in ended.stderr.splitlines())
    return f"{ended.returncode}  $ qdgrasp {line}".rstrip() + f"\n{said if line else ''}"


def _told(name: str) -> Iterator[str]:
    found = getattr(qdgrasp, name)
    yield f"{name}{_arguments(found)}"
    members = vars(found) if inspect.isclass(found) and not issubclass(found, BaseException) else {}
    for member, value in sorted(members.items()):
        if isinstance(value, enum.Enum):
            yield f"    {member} = {value.value}"
        elif not member.startswith("_") and (callable(value) or isinstance(value, property)):
            yield f"    {member}{_arguments(value)}"


def _arguments(found: Any) -> str:
    """The arguments of a callable; a default that is one of our values stands without its class."""
    if not inspect.isroutine(found) and not inspect.isclass(found):
        return ""
    if inspect.isclass(found) and issubclass(found, BaseException | enum.Enum):
        return f"  exit code {found.exit_code}" if issubclass(found, QdgraspError) else ""
    bare = [
        parameter.replace(annotation=parameter.empty)
        for parameter in inspect.signature(found).parameters.values()
    ]
    return re.sub(r"=\w+\(", "=(", str(inspect.Signature(bare)))
