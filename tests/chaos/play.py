"""A run that is disturbed from its first recorded row to its end, and the undisturbed one."""

import heapq
import shutil
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.chaos.plan import Fault, FaultKind
from tests.chaos.processes import JobProcesses, Process
from tests.common import HOST
from tests.fakes.slow_link import SlowLink, slow_link
from tests.system.commands import digest_of

from qdgrasp_protocol.spec import RunSpec, to_toml


def undisturbed_digest(spec: RunSpec, home: Path) -> str:
    """Carry a run out with two workers, undisturbed, in a new folder; returns its digest."""
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    file, run = home / "spec.toml", home / "run"
    file.write_text(to_toml(spec))
    process = Process("run", "qdgrasp", ("run", file, "--workers", 2, "--out", run), home / "log")
    process.start()
    assert process.wait() == 0, process.words
    return digest_of(run)


ROUND_TRIP, LOSS = 0.3, 0.02  # Round trip [s] and loss of the far worker's link
CUT_EVERY = 15.0  # Seconds between two cuts of it
POLL_SECONDS = 0.05  # seconds between two checks of the processes
COUNT_SECONDS = 1.0  # seconds between two readings of the records
FIRST_ROW = 6.0  # Seconds from the start of the processes to the first row, where nothing else has to be done
STANDSTILL = 180.0  # seconds without a new row after which a run is given up, there
RESTART_AFTER = 1.0  # seconds until a process that ended by itself is started again


@dataclass
class RunReport:
    """The events of a run."""

    injected: Counter[tuple[str, FaultKind]] = field(default_factory=Counter)
    """Signals by the kind of process."""
    ended: Counter[str] = field(default_factory=Counter)
    """Processes that ended by themselves before the job was done, by their names."""
    seconds: float = 0.0
    digest: str = ""
    is_given_up: bool = False
    """The job was not done when its time was over."""
    troubles: list[str] = field(default_factory=list)
    """Faults of the run, in words."""

    @property
    def words(self) -> str:
        """The faults in brief."""
        counts = ", ".join(f"{kind} {name} {n}" for (name, kind), n in sorted(self.injected.items()))
        return f"{self.injected.total()} faults in {self.seconds:.0f} s ({counts})"


class FaultInjector:
    """Kills and stops the processes of a job by a plan; once that is over, the run is left alone.

    The run may take `limit` seconds; `say` hears every event. Where processes start more slowly, as the
    machine has other work, faults come more slowly: otherwise no process would live long enough to work.
    """

    def __init__(
        self,
        job: JobProcesses,
        plan: Iterator[Fault],
        limit: float,
        say: Callable[[str], None],
        late: Sequence[Process] = (),
    ) -> None:
        self._late = late
        """Processes that are started once rows are recorded."""
        self._job = job
        self._plan = plan
        self._limit = limit
        self._began = time.monotonic()
        self._tell = say
        self._report = RunReport()
        self._restarts: list[tuple[float, str]] = []
        """Processes to be started again or to go on, by time: a heap."""
        self._has_begun = False
        self._slowness = 1.0
        """How many times longer than on a machine with nothing else to do the processes take to start."""
        self._fault: Fault | None = None
        self._inject_at = 0.0
        self._rows, self._rows_at, self._counted_at = 0, self._began, 0.0

    def carry_out(self) -> RunReport:
        """Disturb the run until its coordinator has ended well, or it is given up."""
        while not self._is_over():
            now = time.monotonic()
            self._restart_due(now)
            self._count(now)
            if self._fault is not None and now >= self._inject_at:
                self._inject(self._fault, now)
            time.sleep(POLL_SECONDS)
        self._report.is_given_up = bool(self._report.troubles)
        end = "given up" if self._report.is_given_up else "over"
        self._say(f"the job is {end}; everybody is asked to stop")
        self._conclude()
        return self._report

    def _is_over(self) -> bool:
        coordinator, now = self._job["coordinator"], time.monotonic()
        for member in self._job:
            self._check_process(member, now)
        if now > self._began + self._limit:
            self._trouble(f"it took more than {self._limit:.0f} s")
        elif now > self._rows_at + STANDSTILL * self._slowness:
            self._trouble(f"no row was recorded for {now - self._rows_at:.0f} s")
        return bool(self._report.troubles) or coordinator.exit_code == 0

    def _check_process(self, member: Process, now: float) -> None:
        """Start a process again that ended by itself, as services are: there may have been no router."""
        code = member.exit_code if member.has_started else None
        if code is None or self._is_awaited(member.name) or (member.name == "coordinator" and code == 0):
            return
        self._report.ended[member.name] += 1
        self._say(f"{member.name} ended with exit code {code}: {member.last_words}")
        self._restart_later(member.name, now + RESTART_AFTER)

    def _is_awaited(self, name: str) -> bool:
        return any(who == name for _, who in self._restarts)

    def _restart_later(self, name: str, at: float) -> None:
        heapq.heappush(self._restarts, (at, name))

    def _restart_due(self, now: float) -> None:
        """Start the processes that are due again, or let them go on."""
        while self._restarts and self._restarts[0][0] <= now:
            member = self._job[heapq.heappop(self._restarts)[1]]
            if member.is_stopped and member.is_there:
                member.send(signal.SIGCONT)
                self._say(f"{member.name} goes on")
            elif not member.is_there:
                member.start()
                self._say(f"{member.name} is started again, pid {member.pid}")

    def _count(self, now: float) -> None:
        """Read the progress of the run; the first fault falls after the first row."""
        if now < self._counted_at + COUNT_SECONDS:
            return
        self._counted_at = now
        rows = self._job.rows
        if rows != self._rows:
            self._rows, self._rows_at = rows, now
            if not self._has_begun:
                self._has_begun = True
                self._slowness = max(1.0, (now - self._began) / FIRST_ROW)
                self._say(f"intervals between faults are {self._slowness:.1f} times those of the plan")
                for member in self._late:
                    member.start()
                    self._say(f"{member.name} is started, pid {member.pid}")
                self._plan_fault(now)

    def _plan_fault(self, now: float) -> None:
        self._fault = next(self._plan, None)
        if self._fault is not None:
            self._inject_at = now + self._fault.after * self._slowness

    def _inject(self, fault: Fault, now: float) -> None:
        """Send the signal, or where there is no such process, take the next fault of the plan."""
        member = self._job[fault.process]
        if member.is_there and not (fault.kind is FaultKind.STOP and member.is_stopped):
            self._say(f"{fault} (pid {member.pid}, {self._rows} rows recorded)")
            self._report.injected[fault.process.partition("-")[0], fault.kind] += 1
            member.send(signal.SIGKILL if fault.kind is FaultKind.KILL else signal.SIGSTOP)
            self._restarts = [restart for restart in self._restarts if restart[1] != fault.process]
            heapq.heapify(self._restarts)
            self._restart_later(fault.process, now + fault.seconds)
        else:
            self._say(
                f"{fault.kind} {fault.process}: it is {'stopped' if member.is_there else 'dead'} already"
            )
        self._plan_fault(now)

    def _conclude(self) -> None:
        self._report.seconds = time.monotonic() - self._began
        late = self._job.end()
        if late:
            self._trouble(f"{', '.join(late)} did not stop when asked to")
        for member in self._job:
            if "Traceback" in member.words:
                self._trouble(f"{member.log} holds a traceback")
        if self._job.rows:
            self._report.digest = digest_of(self._job.run)

    def _trouble(self, what: str) -> None:
        self._report.troubles.append(what)
        self._say(f"TROUBLE: {what}")

    def _say(self, what: str) -> None:
        self._tell(f"{time.monotonic() - self._began:7.1f} s  {what}")


def disturb(
    home: Path,
    spec: RunSpec,
    plan: Iterator[Fault],
    *,
    workers: int,
    row_seconds: float,
    limit: float,
    say: Callable[[str], None],
    bad: Sequence[str] = (),
) -> RunReport:
    """Carry a run out in a new folder while it is disturbed; see `JobProcesses` and `FaultInjector`.

    Bad workers join once rows are recorded, and one that is good and far away: its link takes 0.3 s there and
    back, loses 2 % of what it carries, and is cut now and then.
    """
    with JobProcesses(home, spec, workers=workers, row_seconds=row_seconds) as job, ExitStack() as stack:
        job.start()
        late = [job.add_worker(f"{kind}-0", job.endpoint, CHAOS_BAD=kind) for kind in bad]
        if bad:
            link = stack.enter_context(slow_link(int(job.endpoint.rpartition(":")[2]), ROUND_TRIP, LOSS))
            stack.enter_context(cutting(link))
            late.append(job.add_worker("far-0", f"tcp/{HOST}:{link.port}"))
        return FaultInjector(job, plan, limit, say, late).carry_out()


@contextmanager
def cutting(link: SlowLink) -> Iterator[None]:
    """Cut a link again and again in this context."""
    is_over = threading.Event()

    def cut() -> None:
        while not is_over.wait(CUT_EVERY):
            link.cut()

    thread = threading.Thread(target=cut, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
