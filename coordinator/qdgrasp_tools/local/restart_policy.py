"""Restarts of a job's processes: the meaning of a death, and which are started again."""

from collections.abc import Callable, Iterable

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.session import NotListening
from qdgrasp_protocol.supervisor import ProcessExit, ProcessSupervisor
from qdgrasp_tools.local.progress import ProgressDisplay

GRACE = 1.2
"""Seconds that a command's processes have to stop, of the two of the command itself.

One that takes longer is killed, which loses nothing but its time.
"""
COORDINATOR = "coordinator"


def start_worker(processes: ProcessSupervisor, number: int, arguments: Callable[[], Iterable[str]]) -> None:
    """Start a worker that leaves before it would be killed."""
    grace = ["--grace", f"{processes.children_grace:g}"]
    processes.start(f"worker-{number}", "qdgrasp_worker.cli", lambda: [*arguments(), *grace])


class JobRestarts:
    """Starts processes of a job again that died.

    A process that was killed, or that ended without a sentence, is started again after a while. A coordinator
    that ended with a sentence has decided to; the job then ends with that sentence. Where its port was taken,
    `change_port` chooses another one for it, and returns whether there is to be one.
    """

    def __init__(
        self,
        processes: ProcessSupervisor,
        display: ProgressDisplay,
        change_port: Callable[[], bool] = lambda: False,
    ) -> None:
        self._processes = processes
        self._display = display
        self._change_port = change_port
        self._most = -1
        self.is_done = False
        """The coordinator ended with its job complete, or after the seconds that it was given."""

    def note_progress(self, figures: JobStatus) -> None:
        """Record the job's figures; progress resets the counts of deaths."""
        if figures.evaluations + figures.trials > self._most:
            self._most = figures.evaluations + figures.trials
            self._processes.note_progress()

    def check(self, now: float) -> None:
        """Take the deaths since the last call, and start the processes that are due.

        Raises InputError if a process ended with a sentence that names bad input or environment, and
        EndedEarly if the coordinator ended by decision or order, or a process dies again and again.
        """
        for death in self._processes.exits():
            if death.name == COORDINATOR:
                self._on_coordinator(death, now)
            elif death.exit_code == 0:
                self._display.say(f"{death.name} has left")  # a worker that was asked to
            elif not self.is_done:
                if death.exit_code == InputError.exit_code and not self._processes.is_dead(COORDINATOR):
                    raise InputError(death.words or _silence(death))
                self._restart(death, now)
        self._processes.restart_due(now)

    def _on_coordinator(self, death: ProcessExit, now: float) -> None:
        if not (NotListening.is_of_taken_port(death.words) and self._change_port()):
            if death.exit_code == InputError.exit_code:
                raise InputError(death.words or _silence(death))
            if death.words:
                raise EndedEarly(death.words)
        self.is_done = death.exit_code == 0
        if not self.is_done:
            self._restart(death, now)

    def _restart(self, death: ProcessExit, now: float) -> None:
        pause = self._processes.restart_later(death, now)
        self._display.say(f"{death.name} {death.description}; it is started again in {pause:.1f} s")


def _silence(death: ProcessExit) -> str:
    return f"The {death.name} {death.description}, and its log does not say why: it is gone, or empty."
