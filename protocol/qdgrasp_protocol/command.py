"""What every command of qdgrasp does alike: one clear sentence and an exit code, never a traceback."""

import signal
import sys
from types import FrameType

import typer
from typer.exceptions import TyperException

from qdgrasp_protocol.errors import InputError, QdgraspError


def run_command(app: typer.Typer, name: str) -> None:
    """Run a command line; what goes wrong ends it with a sentence on standard error and an exit code."""
    signal.signal(signal.SIGTERM, _terminated)
    try:
        code = app(prog_name=name, standalone_mode=False)
    except QdgraspError as error:
        code = _said(name, str(error), error.exit_code)
    except TyperException as error:
        code = _said(name, f"{error.format_message()} See `{name} --help`.", InputError.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except BrokenPipeError:
        code = 141
    sys.exit(code if isinstance(code, int) else 0)


def _terminated(number: int, _frame: FrameType | None) -> None:
    """End a command that is not in a `lifetime` yet, through its with-blocks."""
    raise SystemExit(128 + number)


def _said(name: str, sentence: str, code: int) -> int:
    try:
        print(f"{name}: {sentence}", file=sys.stderr, flush=True)  # noqa: T201 - speaks without a logger
    except OSError:
        sys.stderr = None  # a full disk: nothing may be left to flush at the exit
    return code
