"""Shared parts of all commands: options, error sentences and exit codes, never a traceback."""

import errno
import os
import signal
import sys
import threading
import time
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from typer.exceptions import TyperException

from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.process import STOP_SIGNALS, SUPERVISED
from qdgrasp_protocol.session import SECURITY_VARIABLE
from qdgrasp_protocol.text import printable_lines

PROCESSES = "Processes and links"
"""Heading of options in the help of commands."""

ConnectOption = Annotated[
    str | None,
    typer.Option(
        help="Endpoint of the router, or several separated by commas: when one is lost, another takes over; "
        "default: port 7447 on loopback.",
        rich_help_panel=PROCESSES,
    ),
]
WaitOption = Annotated[
    float,
    typer.Option(min=0, help="Seconds to wait for the router at the start.", rich_help_panel=PROCESSES),
]
SecurityOption = Annotated[
    Path | None,
    typer.Option(
        envvar=SECURITY_VARIABLE,
        metavar="DIR",
        help="Folder of certificates, as `qdgrasp security init` writes one: links are encrypted.",
        rich_help_panel=PROCESSES,
    ),
]
InsecureOption = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Listen also where strangers get to, without encryption.",
        rich_help_panel=PROCESSES,
    ),
]


def echo(text: str, *, err: bool = False) -> None:
    """Print text, its lines escaped, as names and reasons from files may stand in it."""
    typer.echo(printable_lines(text), err=err)  # noqa: TID251  # the one place


def _print_version(context: typer.Context, wanted: bool) -> None:
    if wanted:
        echo(f"{context.find_root().info_name} {version('qdgrasp')}")
        raise typer.Exit


VersionOption = Annotated[
    bool,
    typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version, and end."),
]
"""The --version option of every program, handled before its function."""

VALIDATION_WORDS = {"Input should be ": "it must be ", "Value error, ": ""}  # Of a validation, and ours


def usage_error(error: TyperException, name: str) -> str:
    """The sentence that refuses a command line: the fault, and the help that tells more.

    `name` is the program's, for errors that do not know their command.
    """
    context = getattr(error, "ctx", None)
    command = name if context is None else context.command_path
    words = error.format_message()
    for theirs, ours in VALIDATION_WORDS.items():
        words = words.replace(theirs, ours)
    return f"{words.rstrip('.')}. See `{command} --help`."


SIGNAL_GRACE = 1.5  # seconds that a command outside of a `lifetime` may take to hear a signal


def run_command(app: typer.Typer, name: str) -> None:
    """Run a command line; an error ends it with a sentence on stderr and an exit code.

    So do a lost file and a full disk; a process that has a supervisor is started again instead.
    """
    is_supervised = SUPERVISED in os.environ  # until its `lifetime` begins
    try:
        for number in STOP_SIGNALS:
            signal.signal(number, _exit_on_signal)
        _start_forced_exit()
        code = app(prog_name=name, standalone_mode=False)
    except QdgraspError as error:
        code = _print_error(name, str(error), error.exit_code)
    except TyperException as error:
        code = InputError.exit_code
        if error.format_message():  # an empty one printed the help
            _print_error(name, usage_error(error, name), code)
    except typer.Abort:
        code = 130
    except BrokenPipeError:
        code = 141
    except OSError as error:
        if is_supervised or not (sentence := _disk_fault(error)):
            raise
        code = _print_error(name, sentence, InputError.exit_code)
    finally:
        for number in STOP_SIGNALS:
            signal.signal(number, _exit_at_once)
    code = code if isinstance(code, int) else 0
    if is_supervised:
        os._exit(code)  # all is closed, and Python takes up to half a second to forget its modules
    sys.exit(code)


def _disk_fault(error: OSError) -> str:
    """Return the sentence for a file that is not there any more, or a full disk; empty: neither."""
    if error.errno == errno.ENOSPC:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left to print is lost, without a traceback
        return "The disk that it writes to, or its output is sent to, is full: make room, and try again."
    if error.errno == errno.ENOENT and error.filename is not None:
        return f"{os.fsdecode(error.filename)} was deleted or moved meanwhile: put it back, and try again."
    return ""


def _exit_on_signal(number: int, _frame: FrameType | None) -> None:
    """End a command that is not in a `lifetime` yet, through its with-blocks.

    Not by a KeyboardInterrupt: Python kills itself at its end where one has left an `exec` of a text, as
    there are in every dataclass that is being loaded.
    """
    raise SystemExit(128 + number)


def _exit_at_once(number: int, _frame: FrameType | None) -> None:
    """End a finished command at once; Python would print a traceback if disturbed at its end."""
    os._exit(128 + number)


def _start_forced_exit() -> None:
    """End this process some time after a signal, even in a call that blocks its handlers.

    The signal's number comes through a pipe at once, and to another thread. Not used within a `lifetime`.
    """
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    threading.Thread(target=_wait_for_signal, args=(end,), name="signals", daemon=True).start()


def _wait_for_signal(end: int) -> None:
    while (number := os.read(end, 1)[0]) not in STOP_SIGNALS:
        pass
    time.sleep(SIGNAL_GRACE)
    os._exit(128 + number)


def _print_error(name: str, sentence: str, code: int) -> int:
    """Print a sentence, its lines escaped, as it may contain untrusted text."""
    try:
        print(f"{name}: {printable_lines(sentence)}", file=sys.stderr, flush=True)  # noqa: T201  # speaks without a logger
    except OSError:
        sys.stderr = None  # a full disk: nothing may be left to flush at the exit
    return code
