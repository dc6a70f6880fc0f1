"""The rota: the jobs at a worker, how its credit is split among them, and whose turn it is. Pure."""

from collections.abc import Callable, Iterator
from math import inf

from qdgrasp_worker.serving.appointment import Appointment
from qdgrasp_worker.serving.desk import Desk

CREDIT = 2
"""Batches outstanding at a worker, split among its jobs: one in work, one waiting. Each has one at least."""


class Rota:
    """The appointments of a worker, by job."""

    def __init__(self) -> None:
        self._jobs: dict[str, Appointment] = {}
        self._number = 0
        """The highest number of a join to a job that is served no more: numbers go on from there."""

    def __iter__(self) -> Iterator[Appointment]:
        return iter(list(self._jobs.values()))

    def __bool__(self) -> bool:
        """Whether any job is served."""
        return bool(self._jobs)

    def get(self, job: str | None) -> Appointment | None:
        """The appointment with a job; None: there is none."""
        return self._jobs.get(job or "")

    def add(self, job: str) -> Appointment:
        """Begin to serve a job."""
        appointment = self._jobs[job] = Appointment(job)
        appointment.desk.number = self._number
        return appointment

    def end(self, job: str) -> None:
        """Serve a job no more."""
        self._number = max(self._number, self._jobs.pop(job).desk.number)

    @property
    def share(self) -> int:
        """The credit of each job."""
        return max(1, CREDIT // max(1, sum(appointment.has_share for appointment in self)))

    def turn(self, is_servable: Callable[[Desk], bool]) -> Desk | None:
        """The desk whose turn it is, of those that can be served now; its next turn is the last."""
        for job, appointment in self._jobs.items():
            if is_servable(appointment.desk):
                self._jobs[job] = self._jobs.pop(job)
                return appointment.desk
        return None

    def next_join(self) -> float:
        """When the next try to join is due; infinite: nothing is to be tried."""
        times = (appointment.join_at for appointment in self)
        return min((time for time in times if time is not None), default=inf)

    def next_end(self) -> float:
        """When the next appointment is over; infinite: all go on."""
        return min((appointment.ends_at for appointment in self), default=inf)
