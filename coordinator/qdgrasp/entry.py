"""Entry points of the commands.

Signals are handled before anything else is loaded, so that they end a command without a traceback. Loading
takes a part of a second; from then on `run_command` and `lifetime` handle them.
"""

import os
import signal
from functools import partial
from importlib import import_module
from types import FrameType


def _enter(module: str, *names: str) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    import_module(module).main(*names)


def _leave(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)


qdgrasp = partial(_enter, "qdgrasp_tools.cli.main")
coordinator = partial(_enter, "qdgrasp_tools.cli.job_processes", "coordinator")
monitor = partial(_enter, "qdgrasp_tools.cli.job_commands")
recorder = partial(_enter, "qdgrasp_tools.cli.job_processes", "recorder")
router = partial(_enter, "qdgrasp_tools.cli.job_processes", "router")
worker = partial(_enter, "qdgrasp_worker.cli")
