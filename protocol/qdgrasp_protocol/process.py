"""A process of this package: its end, its log, and the child processes that it watches.

A process lives until its work is done, a signal comes, or its parent process is gone. A service waits on an
inbox; stopping puts one more event into it. So no loop polls for signals, and a process ends within the time
that its present piece of work takes. A `ProcessSupervisor` ends every child that is still there, by pid;
should this process itself be killed, each child sees its standard input end and stops (`lifetime`).

Logs are sentences with fields on standard error; a person reads the sentence, a machine the fields.
"""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from traceback import TracebackException
from types import FrameType
from typing import TextIO, cast

import structlog
from setproctitle import setproctitle
from structlog.typing import EventDict, ExcInfo

from qdgrasp_protocol.errors import EndedEarly, ImpossibleValue, InputError
from qdgrasp_protocol.session import SECURITY_VARIABLE
from qdgrasp_protocol.text import printable, printable_lines

SUPERVISED = "QDGRASP_SUPERVISED"
"""Set for a process that ends when its standard input is closed by its parent process."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment that limits each process to one thread."""
WORKERS_PER_CORE, WORKER_BYTES = 4, 3e8  # More workers take memory, and no row comes sooner
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
SIGNAL_REPEAT_INTERVAL = 0.1  # seconds in which the main thread hears a signal, as a rule
ORPHAN_GRACE = 3.0  # seconds that an orphan may take to end by itself


def check_workers(workers: int) -> None:
    """Raise an ImpossibleValue for more workers than cores and memory of this machine hold."""
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    most = min(WORKERS_PER_CORE * (os.cpu_count() or 1), max(1, int(memory / WORKER_BYTES)))
    if workers > most:
        reason = f"{WORKERS_PER_CORE} a core, and one for each {WORKER_BYTES / 1e6:.0f} MB of memory"
        raise ImpossibleValue("workers", workers, f"at most {most}, {reason}")


class Stop:
    """Request to stop this process, with its signal."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self.latest: int | None = None  # Last signal of several; the first decides the exit code
        self._told: list[Callable[[], None]] = []

    @property
    def is_set(self) -> bool:
        """True once this process was asked to stop."""
        return self.signal is not None

    @property
    def exit_code(self) -> int:
        """0, or 128 plus the signal that ended the process: 130 for Ctrl-C, 143 for SIGTERM."""
        return 0 if self.signal is None else 128 + self.signal

    def tell(self, callback: Callable[[], None]) -> None:
        """Register `callback` for the stop request; runs in a signal handler: put and return."""
        self._told.append(callback)

    def set(self, number: int, _frame: FrameType | None = None) -> None:
        """Ask this process to stop; the first reason stays."""
        self.latest = number
        if self.signal is None:
            self.signal = number
        for callback in self._told:
            callback()


@contextmanager
def lifetime(title: str) -> Iterator[Stop]:
    """Set the process title, and turn SIGINT, SIGTERM and the parent's end into a `Stop`.

    Blanks in the title become dashes: Slurm 22.05, which reads names in /proc up to the first blank, does not
    find a process with one, nor signal it.
    """
    setproctitle(title.replace(" ", "-"))
    stop = Stop()
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    threading.Thread(target=_repeat_signal, args=(end, stop), name="signals", daemon=True).start()
    notes = signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    before = {number: signal.signal(number, stop.set) for number in STOP_SIGNALS}
    if os.environ.pop(SUPERVISED, None):
        threading.Thread(target=_end_with_parent, name="starter", daemon=True).start()
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(notes)
        os.close(begin)


def _repeat_signal(end: int, stop: Stop) -> None:
    """Repeat a signal until it is handled: one right before a wait in C would be lost."""
    main = threading.main_thread().ident or 0
    while note := os.read(end, 1):
        while note[0] in STOP_SIGNALS and not stop.is_set:
            time.sleep(SIGNAL_REPEAT_INTERVAL)
            if not stop.is_set:
                signal.pthread_kill(main, note[0])
    os.close(end)


def _end_with_parent() -> None:
    """End this process once the other end of its standard input is closed."""
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ORPHAN_GRACE)  # what is left after it hangs in a call that never returns
    os._exit(128 + signal.SIGTERM)


STANDARD_ERROR = 2


class UnbufferedStderr:
    """Standard error without a buffer; write errors, as on a full disk, are ignored."""

    def write(self, text: str) -> None:
        """Write text at once."""
        with suppress(OSError):
            os.write(STANDARD_ERROR, text.encode(errors="replace"))

    def flush(self) -> None:
        """Do nothing: no text waits."""


def escape_event(_logger: object, _method: str, event: EventDict) -> EventDict:
    """Escape untrusted text; values that are not strings are shown by `repr`, which escapes too."""
    return {name: printable(value) if isinstance(value, str) else value for name, value in event.items()}


def write_traceback(sink: TextIO, error: ExcInfo) -> None:
    """Write a traceback without the values of variables, and with untrusted text escaped."""
    for piece in TracebackException(*error).format():
        is_frame = piece.startswith("  ")  # some lines of code; anything else is a sentence
        for line in piece.rstrip().split("\n") if is_frame else [piece.strip()]:
            sink.write(f"\n{printable(line)}")


class LogFormatter(logging.Formatter):
    """Formats the records of libraries, with untrusted text escaped."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of a record."""
        return printable_lines(super().format(record))


def configure_logging(role: str, *, level: int = logging.INFO) -> None:
    """Send this process's log to standard error, each line marked with its role."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
            escape_event,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), pad_event_to=0, exception_formatter=write_traceback
            ),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(file=cast(TextIO, UnbufferedStderr())),
    )
    structlog.contextvars.bind_contextvars(role=role)
    if logging.lastResort is not None:  # it prints what no handler takes
        logging.lastResort.setFormatter(LogFormatter())


GRACE = 2.0  # seconds that a process may take to stop before it is killed
GRACE_MARGIN = 0.5
"""A child is told to stop within the grace less this margin [s], so that it ends before it is killed."""
FIRST_PAUSE, LAST_PAUSE = 0.5, 10.0  # seconds before a dead process is started again
MOST_DEATHS = 5  # Most deaths in a row without progress that are followed by another start
MOST_OUTSIDE_DEATHS = 20  # The same where the last one came from outside: a kill, or an unreachable router
OUTSIDE_CODES = {-signal.SIGKILL, -signal.SIGTERM, 128 + signal.SIGTERM, InputError.exit_code}


@dataclass
class RestartPolicy:
    """Decides when a process that died is started again, if at all. Pure: time is passed in.

    The pause doubles with each death in a row. A row of deaths ends with progress, which its owner notes, or
    with a life of `steady` seconds where nothing else shows progress.
    """

    steady: float = inf
    deaths: int = 0
    """Deaths in a row, without progress."""
    _started: float = inf

    def on_start(self, now: float) -> None:
        """Note that the process was started."""
        self._started = now

    def on_progress(self) -> None:
        """Note that its work got further."""
        self.deaths = 0

    def on_death(self, now: float, *, is_from_outside: bool) -> float | None:
        """Count a death; returns the seconds before the next start, None: there is to be none."""
        if now - self._started >= self.steady:
            self.deaths = 0
        self.deaths += 1
        if self.deaths > (MOST_OUTSIDE_DEATHS if is_from_outside else MOST_DEATHS):
            return None
        return float(min(FIRST_PAUSE * 2 ** (self.deaths - 1), LAST_PAUSE))


@dataclass(frozen=True)
class ProcessExit:
    """A child ended."""

    name: str
    exit_code: int
    """Exit code; negative: the signal that killed it."""
    words: str = ""
    """The error sentence that it ended with, by its log; empty: none."""
    last_line: str = ""
    """The last line of its log, after an exception what was raised."""

    @property
    def description(self) -> str:
        """Description of the end for a person."""
        if self.exit_code < 0:
            return f"was killed by {signal.Signals(-self.exit_code).name}"
        return f"ended with exit code {self.exit_code}"


class DiesAgain(EndedEarly):
    """A process died again and again without progress."""

    def __init__(self, death: ProcessExit, deaths: int) -> None:
        super().__init__(
            f"The {death.name} died {deaths} times while the job got no further; "
            f"the last time it {death.description}. {death.words}".strip()
        )


Arguments = Callable[[], Iterable[str]]
"""Returns the arguments of a process for its next start."""


@dataclass
class ChildProcess:
    """One process of a supervisor."""

    name: str
    module: str
    arguments: Arguments
    log: Path | None
    """Log file; None: this process's standard error."""
    policy: RestartPolicy
    process: subprocess.Popen[bytes] = field(init=False)
    log_start: int = field(init=False)
    """Byte of the log at which this process began to write."""
    restart_at: float | None = None
    """Time of the next start; infinite: none is planned, None: no death was noted."""

    def start(self, now: float) -> None:
        """Start its process, for the first time or again."""
        self.log_start = self.log.stat().st_size if self.log is not None and self.log.exists() else 0
        command = [sys.executable, "-m", self.module, *self.arguments()]
        self.process = _start(command, self.log)
        self.policy.on_start(now)
        self.restart_at = None

    @property
    def last_lines(self) -> tuple[str, str]:
        """The error sentence with which its process ended, and its last line; empty without one."""
        try:
            said = Path(self.log or os.devnull).read_bytes()[self.log_start :].decode(errors="replace")
        except OSError:
            return "", ""
        sentences = [line for line in said.splitlines() if line.startswith("qdgrasp-") and ": " in line]
        return "".join(sentences[-1:]).partition(": ")[2], said.rstrip().rpartition("\n")[2]


class ProcessSupervisor:
    """Child processes by name, each with a log file in `logs`; None: they use our output.

    They may take `grace` seconds to stop. After `steady` seconds of life, deaths count anew.
    """

    def __init__(self, logs: Path | None, grace: float = GRACE, steady: float = inf) -> None:
        self._logs = logs
        self._grace = grace
        self._steady = steady
        self._leave_by: float | None = None
        self._children: dict[str, ChildProcess] = {}

    @property
    def children_grace(self) -> float:
        """Most seconds that a process may be given to stop."""
        return max(0.0, self._grace - GRACE_MARGIN)

    def start(self, name: str, module: str, arguments: Arguments) -> None:
        """Start `python -m module arguments` as the process `name`."""
        if self._logs is not None:
            self._logs.mkdir(parents=True, exist_ok=True)
        log = None if self._logs is None else self._logs / f"{name}.log"
        child = ChildProcess(name, module, arguments, log, RestartPolicy(self._steady))
        child.start(time.monotonic())
        self._children[name] = child

    def exits(self) -> list[ProcessExit]:
        """Return the processes that ended since the last call."""
        found = []
        for child in self._children.values():
            if (code := child.process.poll()) is not None and child.restart_at is None:
                child.restart_at = inf
                found.append(ProcessExit(child.name, code, *child.last_lines))
        return found

    def restart_later(self, death: ProcessExit, now: float) -> float:
        """Plan the next start of a process that died; returns the seconds until then.

        DiesAgain if it died too often without progress.
        """
        child = self._children[death.name]
        pause = child.policy.on_death(now, is_from_outside=death.exit_code in OUTSIDE_CODES)
        if pause is None:
            raise DiesAgain(death, child.policy.deaths)
        child.restart_at = now + pause
        return pause

    def restart_due(self, now: float) -> None:
        """Start the processes whose pause is over."""
        for child in self._children.values():
            if child.restart_at is not None and child.restart_at <= now:
                child.start(now)

    def note_progress(self) -> None:
        """Note that the work of all got further: deaths count anew."""
        for child in self._children.values():
            child.policy.on_progress()

    def is_dead(self, name: str) -> bool:
        """True if a process died, and was not started again yet."""
        return name in self._children and self._children[name].restart_at is not None

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """Return the process of this name."""
        return self._children[name].process

    def pids(self) -> dict[str, int]:
        """Return the ids of the running processes by name."""
        return {c.name: c.process.pid for c in self._children.values() if c.process.poll() is None}

    def request_stop(self, number: int = signal.SIGTERM) -> None:
        """Send every process a signal to stop; the grace begins with the first."""
        if self._leave_by is None:
            self._leave_by = time.monotonic() + self._grace
        for child in self._children.values():
            child.process.send_signal(number)  # nothing is sent to one that has ended

    def is_late(self, now: float) -> bool:
        """True once the grace after a request to stop is over."""
        return self._leave_by is not None and now >= self._leave_by

    def __enter__(self) -> "ProcessSupervisor":
        return self

    def __exit__(self, *_: object) -> None:
        if self._leave_by is None:
            self.request_stop()
        for child in self._children.values():
            process = child.process
            try:
                process.wait(max(0.0, (self._leave_by or 0.0) - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdin is not None:
                process.stdin.close()


def open_no_link(path: str, flags: int) -> int:
    """Open a file for `open`; an OSError where a link is, which may lead anywhere."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _start(command: list[str], log: Path | None) -> subprocess.Popen[bytes]:
    """Start a process that ends with this one; its own session keeps Ctrl-C from it."""
    environment = {**os.environ, **ONE_THREAD, SUPERVISED: "1"}
    environment.pop(SECURITY_VARIABLE, None)  # children are given the certificate folder by an option
    with nullcontext() if log is None else open(log, "ab", opener=open_no_link) as file:
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=file, stderr=file, start_new_session=True, env=environment
        )
