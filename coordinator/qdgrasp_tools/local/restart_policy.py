"""Restarts of a job's processes: the meaning of a death, and which are started again."""

import signal
from collections import Counter
from collections.abc import Callable, Iterable

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.process import ProcessExit, ProcessGroup, back_off
from qdgrasp_protocol.session import NotListening
from qdgrasp_tools.local.progress import ProgressDisplay

GRACE = 1.2
"""Seconds that a command's processes have to stop, of the two of the command itself.

One that takes longer is killed, which loses nothing but its time.
"""


def start_worker(processes: ProcessGroup, number: int, arguments: Iterable[str]) -> None:
    """Start a worker that leaves before it would be killed."""
    grace = ["--grace", f"{processes.members_grace:g}"]
    processes.start(f"worker-{number}", "qdgrasp_worker.cli", [*arguments, *grace])


COORDINATOR = "coordinator"
MOST_TRIES = 5  # Most deaths of a process without progress of the job, if it last died by itself
MOST_KILLS = 20  # The same, if it was last killed from outside
KILL_CODES = {-signal.SIGKILL, -signal.SIGTERM, 128 + signal.SIGTERM}
"""Exit codes of a process that was killed from outside."""


class RestartPolicy:
    """Decides whether a process that died is started again.

    A process that was killed, or that ended without a sentence, is started again after a while. A coordinator
    that ended with a sentence has decided to; the job then ends with that sentence. `start_coordinator`
    starts it again; None: there is no such process. Where its port was taken, `change_port` chooses another
    one for it, and returns whether there is to be one.
    """

    def __init__(
        self,
        processes: ProcessGroup,
        display: ProgressDisplay,
        start_coordinator: Callable[[], None] | None = None,
        change_port: Callable[[], bool] = lambda: False,
    ) -> None:
        self._processes = processes
        self._display = display
        self._start_coordinator = start_coordinator
        self._change_port = change_port
        self._start_at: float | None = None
        self._deaths: Counter[str] = Counter()
        self._most = -1
        self.is_done = False
        """The coordinator ended with its job complete, or after the seconds that it was given."""

    @property
    def awaits_coordinator(self) -> bool:
        """True while the coordinator is down, until it is started again."""
        return self._start_at is not None

    def note_progress(self, figures: JobStatus) -> None:
        """Record the job's figures; progress resets the counts of deaths."""
        if figures.evaluations + figures.trials > self._most:
            self._most = figures.evaluations + figures.trials
            self._deaths.clear()

    def check(self, now: float) -> None:
        """Count deaths, and restart the processes that may be.

        Raises InputError if a process ended with a sentence that names bad input or environment, and
        EndedEarly if the coordinator ended by decision or order, or a process dies again and again.
        """
        for death in self._processes.exits():
            if death.name == COORDINATOR:
                self._coordinator_died(death, now)
            elif not self.is_done:
                self._other_died(death, now)
        self._processes.restart_due(now)
        if self._start_coordinator is not None and self._start_at is not None and now >= self._start_at:
            self._start_at = None
            self._start_coordinator()

    def _coordinator_died(self, death: ProcessExit, now: float) -> None:
        words = self._processes.last_error(death.name)
        if not (NotListening.is_of_taken_port(words) and self._change_port()):
            if death.exit_code == InputError.exit_code:
                raise InputError(words or self._silence(death))
            if words:
                raise EndedEarly(words)
        if death.exit_code == 0:
            self.is_done = True
            return
        self._count(death)
        pause = back_off(self._deaths[death.name] - 1)
        self._start_at = now + pause
        self._say(death, pause)

    def _other_died(self, death: ProcessExit, now: float) -> None:
        """Restart a worker or the recorder; a worker that ended well was asked to leave."""
        if death.exit_code == 0:
            self._display.say(f"{death.name} has left")
            return
        if death.exit_code == InputError.exit_code and self._start_at is None:
            raise InputError(self._processes.last_error(death.name) or self._silence(death))
        self._count(death)
        self._say(death, self._processes.restart_later(death.name, now))

    @staticmethod
    def _silence(death: ProcessExit) -> str:
        return f"The {death.name} {death.description}, and its log does not say why: it is gone, or empty."

    def _count(self, death: ProcessExit) -> None:
        self._deaths[death.name] += 1
        most = MOST_KILLS if death.exit_code in KILL_CODES else MOST_TRIES
        if self._deaths[death.name] > most:
            words = self._processes.last_error(death.name)
            raise EndedEarly(
                f"The {death.name} died {most + 1} times while the job got no further; "
                f"the last time it {death.description}. {words}".strip()
            )

    def _say(self, death: ProcessExit, pause: float) -> None:
        self._display.say(f"{death.name} {death.description}; it is started again in {pause:.1f} s")
