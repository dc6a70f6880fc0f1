"""Memberships: this worker meets coordinators, joins their jobs, and leaves them."""

import os
import random
import socket
from contextlib import AbstractContextManager
from typing import Self

import structlog

from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys, job_of, last_chunk, number
from qdgrasp_protocol.messages import VERSION, Join, Joined
from qdgrasp_worker.serving.appointment import Appointment
from qdgrasp_worker.serving.errands import Answered, Errands
from qdgrasp_worker.serving.rota import Rota

log = structlog.get_logger()


class RefusedByJob(Refused):
    """The only job this worker was meant for does not take it."""

    exit_code = 2

    def __init__(self, job: str, reason: object) -> None:
        super().__init__(f"Job '{job}' does not take this worker: {reason}")


class Memberships:
    """What a worker is to the jobs on a bus; a context manager that hands its tokens in.

    Parameters
    ----------
    jobs
        The appointments, which are kept up here.
    only
        The only job to serve; None: every job there is.
    """

    def __init__(self, bus: Bus, errands: Errands, jobs: Rota, wid: str, only: str | None) -> None:
        self._bus = bus
        self._errands = errands
        self._jobs = jobs
        self._wid = wid
        self._only = only
        self._tokens: dict[str, AbstractContextManager[None]] = {}
        self._left: dict[str, int] = {}
        """The epochs of coordinators that drained this worker, and are there, by job."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for job in list(self._tokens):
            self._hand_in(job)

    def meet(self, key: str, is_alive: bool, now: float) -> None:
        """Note that a job's coordinator is there, or is gone, by its token."""
        job, token = job_of(key), last_chunk(key)
        epoch = number(token)
        if job is None or epoch is None:
            return
        appointment = self._jobs.get(job)
        left = self._left.get(job, -1)
        if epoch > left or (epoch == left and not is_alive):
            self._left.pop(job, None)
        if is_alive and appointment is None and epoch > left:
            appointment = self._open(job)
        if appointment is not None:
            appointment.meet(epoch, is_alive, now)

    def reconnected(self, now: float) -> None:
        """Hear that the link is up again: coordinators may have given this worker up."""
        for appointment in self._jobs:
            appointment.join_soon(now)

    def join_due(self, now: float, platform: dict[str, str], *, is_open: bool) -> None:
        """Join what is to be joined; a worker that is not open asks for no work."""
        for appointment in self._jobs:
            credit = self._jobs.share if is_open and not appointment.desk.is_draining else 0
            appointment.set_credit(credit, now)
            if appointment.is_due(now):
                self._join(appointment, credit, platform)

    def _join(self, appointment: Appointment, credit: int, platform: dict[str, str]) -> None:
        desk = appointment.desk
        request = Join(
            versions=[VERSION],
            wid=self._wid,
            number=appointment.ask(credit),
            credit=credit,
            held=desk.held,
            host=socket.gethostname(),
            pid=os.getpid(),
            platform=platform,
        )
        self._errands.join(desk.job, request)

    def answered(self, answered: Answered, now: float) -> list[Sample]:
        """Hear whether a job takes this worker; gives the messages that waited for this.

        Raises
        ------
        RefusedByJob
            It does not, and is the only one to serve.
        """
        appointment = self._jobs.get(answered.job)
        if appointment is None or answered.number != appointment.desk.number:
            return []
        desk, epoch = appointment.desk, appointment.desk.epoch
        match answered.answer:
            case Joined() as answer:
                if appointment.answered(answer, now, jitter()) and desk.epoch != epoch:
                    log.info("joined", job=desk.job, epoch=desk.epoch, worker=self._wid[:8])
            case Refused() as reason:
                appointment.refused()
                log.error("a job does not take this worker", job=desk.job, reason=str(reason))
                if self._only:
                    raise RefusedByJob(desk.job, reason)
            case _:
                appointment.unanswered(now, jitter())
        return appointment.let_go()

    def leave_drained(self) -> bool:
        """Leave the jobs whose coordinators asked for that, once nothing of them is held.

        Gives whether that ends this worker: there is no other job for it.
        """
        is_last = False
        for appointment in self._jobs:
            desk = appointment.desk
            if appointment.is_dismissed:
                log.info("left a job, as its coordinator asked", job=desk.job)
                if not desk.is_orphaned:
                    self._left[desk.job] = desk.epoch
                self._close(desk.job)
                is_last = self._only is not None
        return is_last

    def end_over(self, now: float) -> None:
        """End the appointments with jobs that have had no coordinator for long."""
        for appointment in self._jobs:
            if now >= appointment.ends_at:
                log.info("a job has no coordinator any more", job=appointment.desk.job)
                self._close(appointment.desk.job)

    def _open(self, job: str) -> Appointment:
        self._tokens[job] = self._bus.token(Keys(job).worker_token(self._wid))
        return self._jobs.add(job)

    def _close(self, job: str) -> None:
        self._jobs.end(job)
        self._hand_in(job)

    def _hand_in(self, job: str) -> None:
        self._tokens.pop(job).__exit__(None, None, None)


def jitter() -> float:
    """By how much a pause is stretched, so that not all workers ask at once: 0.5 to 1.5."""
    return random.uniform(0.5, 1.5)  # noqa: S311  # nothing is kept secret by it
