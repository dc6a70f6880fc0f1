"""A command in a process of its own, forked from one that has loaded what commands need.

To load it takes longer than most of them do; all else is as when a person types them.
"""

import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.patience import PATIENCE

from qdgrasp import entry

LOADED = [
    "qdgrasp_coordinator.cli.main",
    "qdgrasp_coordinator.cli.monitor",
    "qdgrasp_coordinator.runs.preparation",
    "trimesh",
]
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(LOADED)


def run(words: Sequence[str], home: Path, environment: dict[str, str], said: Sequence[Path]) -> int:
    """Run a command in a folder; gives its exit code.

    Parameters
    ----------
    words
        The function of `qdgrasp.entry`, and the command's arguments.
    said
        Two files, for what it says on standard output and standard error.
    """
    process = _FORKS.Process(target=_enter, args=(words, home, environment, said))
    process.start()
    process.join(PATIENCE)
    if process.exitcode is None:
        process.terminate()
        raise TimeoutError(f"{' '.join(words)} takes more than {PATIENCE:.0f} s")
    return process.exitcode


def _enter(words: Sequence[str], home: Path, environment: dict[str, str], said: Sequence[Path]) -> None:
    os.chdir(home)
    os.environ.clear()
    os.environ.update(environment)
    for descriptor, path in enumerate(said, start=1):
        with path.open("wb") as file:
            os.dup2(file.fileno(), descriptor)
    sys.argv = [*words]
    getattr(entry, words[0])()
