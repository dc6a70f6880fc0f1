"""Carries batches from jobs to the simulator and their results back, also while the worker leaves.

A worker leaves at once, or when the batch in work is done if that fits into its grace. That decision is
pure: time is passed in, in seconds of any steady clock.
"""

from collections.abc import Callable
from math import inf

import structlog

from qdgrasp_protocol.bundle_transfer import TooLarge
from qdgrasp_worker.runtime.background_requests import SceneAnswered, SceneCache
from qdgrasp_worker.runtime.batch_queue import BatchProgress
from qdgrasp_worker.runtime.job_registry import JobRegistry, JobSession, jitter
from qdgrasp_worker.runtime.simulator_supervisor import BatchOutcomes, SimulatorSupervisor

HAND_BACK_SECONDS = 0.5  # The last seconds of a grace, in which a batch that was not finished is handed back


class GracefulShutdown:
    """A worker's leave.

    Parameters
    ----------
    grace
        Seconds until the batch in work is finished or handed back.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._finish_by = inf
        self._gone_by = inf
        self._told: set[str] = set()
        self.kept: BatchProgress | None = None
        """The batch that is to be finished before."""

    @property
    def has_begun(self) -> bool:
        """Nothing new is begun any more."""
        return self._gone_by < inf

    @property
    def deadline(self) -> float:
        """When something is to be done at the latest; infinite: nobody asked."""
        return self._gone_by if self.kept is None else self._finish_by

    def at_once(self) -> None:
        """Leave whatever there is."""
        self._gone_by = -inf

    def begin(self, head: BatchProgress | None, now: float) -> None:
        """Leave soon, with `head`, the batch in work, finished before if that fits."""
        self._finish_by = now + self._grace - HAND_BACK_SECONDS
        self._gone_by = now + max(self._grace, HAND_BACK_SECONDS)
        if head is not None and now + head.seconds_left(now) <= self._finish_by:
            self.kept = head

    def is_late(self, now: float) -> bool:
        """Whether the batch that is kept has to be handed back now."""
        return self.kept is not None and now >= self._finish_by

    def forget(self, task: BatchProgress) -> None:
        """Hear that a batch is done with, or handed back."""
        if task is self.kept:
            self.kept = None

    def tell(self, job: str) -> None:
        """Wait for a job to hear what is handed back."""
        self._told.add(job)

    def heard(self, job: str) -> None:
        """Hear that a job knows, or cannot know, what is handed back."""
        self._told.discard(job)

    def is_over(self, now: float) -> bool:
        """Whether it is time to go."""
        return now >= self._gone_by or (self.has_begun and self.kept is None and not self._told)


log = structlog.get_logger()


class BatchRunner:
    """Batches on their way.

    Parameters
    ----------
    jobs
        Whose desks they come from.
    workshop
        Where they are evaluated.
    scenes
        Where their scenes come from.
    leave
        Whether anything new is begun, and what is waited for.
    send
        Sends the result of a batch to its coordinator.
    """

    def __init__(
        self,
        jobs: JobRegistry,
        workshop: SimulatorSupervisor,
        scenes: SceneCache,
        leave: GracefulShutdown,
        send: Callable[[BatchProgress], None],
    ) -> None:
        self._jobs = jobs
        self._workshop = workshop
        self._scenes = scenes
        self._leave = leave
        self._send = send

    @property
    def head(self) -> BatchProgress | None:
        """The batch in work, if somebody is there to hear what becomes of it."""
        head = self._workshop.head
        appointment = self._jobs.get(head.job) if head else None
        return head if appointment is not None and appointment.alive else None

    def feed(self, now: float) -> None:
        """Let the simulator have what it has room for."""
        while self._workshop.has_room and (task := self._next()) is not None:
            scene = task.work.scene
            if self._workshop.is_fatal(scene):
                self._fail(task, "its scene ends every simulator", now)
            else:
                known = self._workshop.has_scene(scene)
                self._workshop.put(task, None if known else self._scenes.take(scene), now)

    def settle(self, upshot: BatchOutcomes, now: float) -> None:
        """Send the results of what is done, and hand back what is lost."""
        for task in upshot.done:
            if self._is_wanted(task):
                self._send(task)
            self._release(task)
        for task in upshot.lost:
            self._hand_back(task, now)

    def scene_came(self, fetched: SceneAnswered, now: float) -> None:
        """Take a scene; where there is none, its batches are handed back, or fail if there can be none."""
        self._scenes.came(fetched)
        reason = fetched.bundle
        if isinstance(reason, bytes):
            return
        log.warning("a scene cannot be had", job=fetched.job, scene=fetched.scene[:12], reason=str(reason))
        for task in self._waiting_for(fetched.job, fetched.scene):
            if isinstance(reason, TooLarge):
                self._fail(task, str(reason), now)
            else:
                self._hand_back(task, now)

    # What is next.

    def _next(self) -> BatchProgress | None:
        """The next batch whose scene is at hand: first what was begun before, then by turns of the jobs."""
        while (task := self._workshop.next_again) is not None:
            if self._is_wanted(task):
                return task if self._has_scene(task.job, task.work.scene) else None
            self._workshop.drop(task)
            self._release(task)
        desk = None if self._leave.has_begun else self._jobs.turn(self._is_servable)
        work = None if desk is None else desk.begin()
        return None if desk is None or work is None else BatchProgress(desk.job, work)

    def _is_servable(self, desk: JobSession) -> bool:
        work = desk.next()
        return work is not None and self._has_scene(desk.job, work.scene)

    def _has_scene(self, job: str, scene: str) -> bool:
        known = self._workshop.has_scene(scene) or self._workshop.is_fatal(scene)
        return known or self._scenes.has(job, scene)

    def _waiting_for(self, job: str, scene: str) -> list[BatchProgress]:
        """The batches of a job that cannot be evaluated without a scene, taken from where they wait."""
        tasks = []
        while (task := self._workshop.next_again) is not None and (task.job, task.work.scene) == (job, scene):
            self._workshop.drop(task)
            tasks.append(task)
        appointment = self._jobs.get(job)
        works = appointment.desk.waiting if appointment else []
        return tasks + [BatchProgress(job, work) for work in works if work.scene == scene]

    # What becomes of a batch.

    def _is_wanted(self, task: BatchProgress) -> bool:
        """Whether the result of a batch is waited for."""
        appointment = self._jobs.get(task.job)
        return appointment is not None and appointment.desk.holds(task.work.batch)

    def _fail(self, task: BatchProgress, reason: str, now: float) -> None:
        task.fail(reason)
        self.settle(BatchOutcomes(done=[task]), now)

    def _hand_back(self, task: BatchProgress, now: float) -> None:
        """Let a batch go; the next join, which does not list it, has it evaluated elsewhere."""
        self._release(task)
        appointment = self._jobs.get(task.job)
        if appointment is not None:
            appointment.join_later(now, jitter())

    def _release(self, task: BatchProgress) -> None:
        self._leave.forget(task)
        appointment = self._jobs.get(task.job)
        if appointment is not None:
            appointment.desk.release(task.work.batch)
