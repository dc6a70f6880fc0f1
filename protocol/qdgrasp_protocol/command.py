"""What every command of qdgrasp does alike: one clear sentence and an exit code, never a traceback."""

import os
import signal
import sys
import threading
import time
from types import FrameType

import typer
from typer.exceptions import TyperException

from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.lifetime import HEARD
from qdgrasp_protocol.printable import printable
from qdgrasp_protocol.usage import misuse

PATIENCE = 1.5  # seconds that a command outside of a `lifetime` may take to hear a signal


def run_command(app: typer.Typer, name: str) -> None:
    """Run a command line; what goes wrong ends it with a sentence on standard error and an exit code."""
    try:
        for number in HEARD:
            signal.signal(number, _stopped)
        _end_by_force_if_need_be()
        code = app(prog_name=name, standalone_mode=False)
    except QdgraspError as error:
        code = _said(name, str(error), error.exit_code)
    except TyperException as error:
        code = _misused(name, error)
    except typer.Abort:
        code = 130
    except BrokenPipeError:
        code = 141
    finally:
        for number in HEARD:
            signal.signal(number, _leave)
    sys.exit(code if isinstance(code, int) else 0)


def _stopped(number: int, _frame: FrameType | None) -> None:
    """End a command that is not in a `lifetime` yet, through its with-blocks.

    Not by a KeyboardInterrupt: Python kills itself at its end where one has left an `exec` of a text, as
    there are in every dataclass that is being loaded.
    """
    raise SystemExit(128 + number)


def _leave(number: int, _frame: FrameType | None) -> None:
    """End a command that is done already; Python itself prints a trace where its end is disturbed."""
    os._exit(128 + number)


def _end_by_force_if_need_be() -> None:
    """End this process some time after a signal: it may be in a call that lets nobody hear one for minutes.

    The kernel's note of a signal comes at once, and to another thread. There are none within a `lifetime`.
    """
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    threading.Thread(target=_wait_for_a_note, args=(end,), name="signals", daemon=True).start()


def _wait_for_a_note(end: int) -> None:
    while (number := os.read(end, 1)[0]) not in HEARD:
        pass
    time.sleep(PATIENCE)
    os._exit(128 + number)


def _misused(name: str, error: TyperException) -> int:
    """Say what was wrong with a command line; one with nothing in it is answered with the whole help."""
    words = error.format_message()
    if words.startswith("Usage: "):
        print(words, file=sys.stderr, flush=True)  # noqa: T201  # help is for a person who asked for nothing else
        return InputError.exit_code
    return _said(name, misuse(error, name), InputError.exit_code)


def _said(name: str, sentence: str, code: int) -> int:
    try:
        print(f"{name}: {_plain(sentence)}", file=sys.stderr, flush=True)  # noqa: T201  # speaks without a logger
    except OSError:
        sys.stderr = None  # a full disk: nothing may be left to flush at the exit
    return code


def _plain(sentence: str) -> str:
    """The lines of a sentence, in which there may be words of others."""
    return "\n".join(map(printable, sentence.split("\n")))
