"""Entry points of the commands.

Signals are handled before anything else is loaded, so that they end a command without a traceback. Loading
takes a part of a second; from then on `run_command` and `lifetime` handle them.
"""

import os
import signal
from importlib import import_module
from types import FrameType


def qdgrasp() -> None:
    """Entry point of `qdgrasp`."""
    _enter("qdgrasp_tools.cli.main")


def coordinator() -> None:
    """Entry point of `qdgrasp-coordinator`."""
    _enter("qdgrasp_tools.cli.coordinator_process")


def monitor() -> None:
    """Entry point of `qdgrasp-monitor`."""
    _enter("qdgrasp_tools.cli.monitor_process")


def recorder() -> None:
    """Entry point of `qdgrasp-recorder`."""
    _enter("qdgrasp_tools.cli.recorder_process")


def router() -> None:
    """Entry point of `qdgrasp-router`."""
    _enter("qdgrasp_tools.cli.router_process")


def worker() -> None:
    """Entry point of `qdgrasp-worker`."""
    _enter("qdgrasp_worker.cli")


def _enter(module: str) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    import_module(module).main()


def _leave(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)
