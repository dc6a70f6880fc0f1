"""The belt: it carries batches from the desks of jobs to the simulator, and back what becomes of them."""

from collections.abc import Callable

import structlog

from qdgrasp_protocol.chunks import TooLarge
from qdgrasp_worker.serving.desk import Desk
from qdgrasp_worker.serving.errands import Fetched
from qdgrasp_worker.serving.leave import Leave
from qdgrasp_worker.serving.memberships import jitter
from qdgrasp_worker.serving.rota import Rota
from qdgrasp_worker.serving.scenes import Scenes
from qdgrasp_worker.serving.task import Task
from qdgrasp_worker.serving.workshop import Upshot, Workshop

log = structlog.get_logger()


class Belt:
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
        jobs: Rota,
        workshop: Workshop,
        scenes: Scenes,
        leave: Leave,
        send: Callable[[Task], None],
    ) -> None:
        self._jobs = jobs
        self._workshop = workshop
        self._scenes = scenes
        self._leave = leave
        self._send = send

    @property
    def head(self) -> Task | None:
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

    def settle(self, upshot: Upshot, now: float) -> None:
        """Send the results of what is done, and hand back what is lost."""
        for task in upshot.done:
            if self._is_wanted(task):
                self._send(task)
            self._release(task)
        for task in upshot.lost:
            self._hand_back(task, now)

    def scene_came(self, fetched: Fetched, now: float) -> None:
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

    def _next(self) -> Task | None:
        """The next batch whose scene is at hand: first what was begun before, then by turns of the jobs."""
        while (task := self._workshop.next_again) is not None:
            if self._is_wanted(task):
                return task if self._has_scene(task.job, task.work.scene) else None
            self._workshop.drop(task)
            self._release(task)
        desk = None if self._leave.has_begun else self._jobs.turn(self._is_servable)
        work = None if desk is None else desk.begin()
        return None if desk is None or work is None else Task(desk.job, work)

    def _is_servable(self, desk: Desk) -> bool:
        work = desk.next()
        return work is not None and self._has_scene(desk.job, work.scene)

    def _has_scene(self, job: str, scene: str) -> bool:
        known = self._workshop.has_scene(scene) or self._workshop.is_fatal(scene)
        return known or self._scenes.has(job, scene)

    def _waiting_for(self, job: str, scene: str) -> list[Task]:
        """The batches of a job that cannot be evaluated without a scene, taken from where they wait."""
        tasks = []
        while (task := self._workshop.next_again) is not None and (task.job, task.work.scene) == (job, scene):
            self._workshop.drop(task)
            tasks.append(task)
        appointment = self._jobs.get(job)
        works = appointment.desk.waiting if appointment else []
        return tasks + [Task(job, work) for work in works if work.scene == scene]

    # What becomes of a batch.

    def _is_wanted(self, task: Task) -> bool:
        """Whether the result of a batch is waited for."""
        appointment = self._jobs.get(task.job)
        return appointment is not None and appointment.desk.holds(task.work.batch)

    def _fail(self, task: Task, reason: str, now: float) -> None:
        task.fail(reason)
        self.settle(Upshot(done=[task]), now)

    def _hand_back(self, task: Task, now: float) -> None:
        """Let a batch go; the next join, which does not list it, has it evaluated elsewhere."""
        self._release(task)
        appointment = self._jobs.get(task.job)
        if appointment is not None:
            appointment.join_later(now, jitter())

    def _release(self, task: Task) -> None:
        self._leave.forget(task)
        appointment = self._jobs.get(task.job)
        if appointment is not None:
            appointment.desk.release(task.work.batch)
