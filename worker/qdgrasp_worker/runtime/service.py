"""The worker on the bus: join, evaluate, answer.

One thread does everything; callbacks of the bus, the simulator and background requests only fill its inbox,
and it waits for nothing else. A worker has no state but caches: lost batches are evaluated again elsewhere,
with the same bytes.
"""

import os
import secrets
import signal
import socket
import time
from contextlib import ExitStack
from dataclasses import dataclass
from math import inf
from queue import Empty, SimpleQueue
from typing import TypeAlias

import msgspec
import structlog

from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import Build
from qdgrasp_protocol.bus import (
    Bus,
    Channel,
    DropCounter,
    LinkChange,
    Sample,
    TokenChange,
    TooLarge,
    decode_sample,
)
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import AnyJob, Keys, job_of
from qdgrasp_protocol.messages import VERSION, Control, Heartbeat, Join, Work, shorten, worker_id, worker_key
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.process_limits import process_stats
from qdgrasp_worker.runtime.background_tasks import (
    BackgroundRequests,
    BuildEnded,
    BuilderClient,
    JoinAnswered,
    SceneAnswered,
)
from qdgrasp_worker.runtime.job_registry import JobRegistry, JobSession, jitter
from qdgrasp_worker.runtime.simulator_messages import BatchProgress
from qdgrasp_worker.runtime.simulator_supervisor import (
    SimulatorEnded,
    SimulatorEvent,
    SimulatorSaid,
    SimulatorSupervisor,
)

log = structlog.get_logger()

HEARTBEAT_INTERVAL = 1.0  # Seconds between two heartbeats
MAX_SCENES = 8  # Scenes kept in memory; the oldest is dropped first, and requested again if needed


@dataclass(frozen=True)
class StopRequested:
    """The process is asked to stop."""


Event = (
    Sample
    | TokenChange
    | LinkChange
    | StopRequested
    | JoinAnswered
    | SceneAnswered
    | SimulatorEvent
    | BuildEnded
)
Inbox: TypeAlias = "SimpleQueue[Event]"


class WorkerService:
    """Serves the jobs on a bus until it is asked to stop.

    The simulator's events come to `inbox`, which this service waits on. It serves one `job`, or every job
    there is. After SIGTERM the batch in work may still take `grace` seconds. Its device evaluates `rows` at
    once; 0: it has no device. It builds shapes with the code of the digest `builds`, at the niceness `nice`;
    an empty digest: it builds none.
    """

    def __init__(
        self,
        bus: Bus,
        stop: Stop,
        simulator: SimulatorSupervisor,
        inbox: Inbox,
        *,
        job: str | None,
        grace: float,
        rows: int = 0,
        builds: str = "",
        nice: int = 0,
    ) -> None:
        self._key = worker_key(secrets.token_bytes(16))
        self.wid = worker_id(self._key)
        self._bus = bus
        self._stop = stop
        self._simulator = simulator
        self._inbox = inbox
        self._requests = BackgroundRequests(bus, inbox.put)
        join = Join(
            versions=[VERSION],
            wid=self.wid,
            key=self._key,
            number=0,
            credit=0,
            rows=rows,
            builds=builds,
            held=[],
            host=socket.gethostname(),
            pid=os.getpid(),
            platform={},
        )
        self._jobs = JobRegistry(bus, self._requests, join, job)
        self._scenes: dict[str, bytes] = {}  # Bundles by digest
        self._requested: set[str] = set()  # Digests of scenes that are fetched now
        self._builder = BuilderClient(bus, inbox.put, nice)
        self._keys = Keys(job) if job else AnyJob()
        self._grace = grace
        self._deadline = inf
        """Time at which it ends at the latest; infinite: no stop was asked for."""
        self._last_batch: BatchProgress | None = None
        """The batch that is to be finished before."""
        self._uninformed: set[str] = set()
        """The jobs that do not know yet which batches are handed back."""
        self._drops = DropCounter()
        self._heartbeat_at = 0.0

    def run(self) -> None:
        """Serve until asked to stop.

        RefusedByJob if the only job to serve does not take this worker; NoSimulator or OtherPlatform if
        nothing can be evaluated here, or no longer.
        """
        put = self._inbox.put
        self._stop.tell(lambda: put(StopRequested()))
        if self._stop.is_set:
            return
        with ExitStack() as stack:
            stack.enter_context(self._jobs)
            stack.callback(self._builder.stop)
            stack.enter_context(self._bus.subscribe(self._keys.work(self.wid), put))
            stack.enter_context(self._bus.subscribe(self._keys.ctl(self.wid), put))
            stack.enter_context(self._bus.on_link(lambda up: put(LinkChange(up))))
            token = self._keys.coordinator_token()
            stack.enter_context(self._bus.watch(token, lambda key, alive: put(TokenChange(key, alive))))
            while not self._is_over(time.monotonic()):
                self._receive(self._wait_seconds(time.monotonic()))
                self._step(time.monotonic())

    @property
    def _is_ending(self) -> bool:
        """True if no new batch is begun any more."""
        return self._deadline < inf

    def _is_over(self, now: float) -> bool:
        """Return whether all is finished and told that is to be, or time is up."""
        return now >= self._deadline or (self._is_ending and not (self._last_batch or self._uninformed))

    def _step(self, now: float) -> None:
        if now >= self._heartbeat_at:
            self._heartbeat_at = now + HEARTBEAT_INTERVAL
            self._send_heartbeat(has_run=self._simulator.on_heartbeat())
        self._simulator.step(now)
        self._submit_batches()
        self._begin_build()
        if self._simulator.platform is not None:
            is_open = self._simulator.is_ready and not self._is_ending
            self._jobs.join_due(now, self._simulator.platform, is_open=is_open)
        self._jobs.end_abandoned(now)
        if self._jobs.leave_drained():
            self._deadline = -inf

    def _wait_seconds(self, now: float) -> float:
        """Seconds to wait for the inbox."""
        join_at = inf if self._simulator.platform is None else self._jobs.next_join
        others = self._jobs.next_end, self._deadline, self._simulator.restart_at
        return max(0.0, min(self._heartbeat_at, join_at, *others) - now)

    def _receive(self, seconds: float) -> None:
        try:
            self._take(self._inbox.get(timeout=seconds), time.monotonic())
            while True:
                self._take(self._inbox.get_nowait(), time.monotonic())
        except Empty:
            return

    def _take(self, event: Event, now: float) -> None:
        match event:
            case Sample():
                self._read(event)
            case SimulatorSaid() | SimulatorEnded():
                for task in self._simulator.on_event(event, now):
                    if task.is_done:
                        self._finish(task)
                    else:
                        self._hand_back(task, now)
            case SceneAnswered():
                self._take_scene(event, now)
            case BuildEnded():
                self._answer_build(event)
            case JoinAnswered():
                self._take_answer(event, now)
            case TokenChange(key, is_alive):
                self._jobs.on_coordinator(key, is_alive, now)
            case LinkChange(is_up) if is_up:
                self._jobs.on_link_up(now)
            case StopRequested():
                self._begin_shutdown(now)

    def _read(self, sample: Sample) -> None:
        session = self._jobs.get(job_of(sample.key))
        if session is None or session.defer(sample):
            return
        try:
            if sample.encoding == messages.encoding(Build) and sample.key == Keys(session.job).work(self.wid):
                session.accept(decode_sample(sample, Build))
            elif sample.key == Keys(session.job).work(self.wid):
                session.accept(decode_sample(sample, Work))
            else:
                session.on_control(decode_sample(sample, Control))
        except MessageError as error:
            self._drops.note(sample.key, error)

    def _take_answer(self, answered: JoinAnswered, now: float) -> None:
        for sample in self._jobs.on_join_answered(answered, now):
            self._read(sample)
        session = self._jobs.get(answered.job)
        if session is None or not session.credit:
            self._uninformed.discard(answered.job)

    def _take_scene(self, answered: SceneAnswered, now: float) -> None:
        """Take a scene; without one, its batches are handed back, or fail if no one can have it."""
        reason, job, scene = answered.bundle, answered.job, answered.scene
        self._requested.discard(scene)
        if isinstance(reason, bytes):
            self._scenes[scene] = reason
            if len(self._scenes) > MAX_SCENES:
                del self._scenes[next(iter(self._scenes))]
            return
        log.warning("a scene cannot be had", job=job, scene=scene[:12], reason=str(reason))
        tasks = []
        while (task := self._simulator.next_requeued) and (task.job, task.work.scene) == (job, scene):
            self._simulator.drop(task)
            tasks.append(task)
        session = self._jobs.get(job)
        waiting = session.waiting(Work) if session else []
        for task in tasks + [BatchProgress(job, work) for work in waiting if work.scene == scene]:
            if isinstance(reason, TooLarge):
                task.fail_all(str(reason))
                self._finish(task)
            else:
                self._hand_back(task, now)

    def _begin_shutdown(self, now: float) -> None:
        """Leave: after SIGTERM with the batch in work, after SIGINT at once."""
        if self._stop.latest != signal.SIGTERM:
            self._deadline = -inf
        elif not self._is_ending:
            head = self._simulator.head
            session = self._jobs.get(head.job) if head else None
            self._deadline = now + self._grace
            self._last_batch = head if session is not None and session.has_coordinator else None
            self._hand_back_all(now)

    def _submit_batches(self) -> None:
        while self._simulator.has_room and (task := self._next_batch()) is not None:
            scene = task.work.scene
            if self._simulator.is_fatal(scene):
                task.fail_all("its scene ends every simulator")
                self._finish(task)
            else:
                bundle = None if self._simulator.has_scene(scene) else self._scenes[scene]
                self._simulator.submit(task, bundle)

    def _begin_build(self) -> None:
        """Begin the next build, if none is under way; end one that is not wanted any more.

        Batches at hand are evaluated beside it: the coordinator sends no more until it is done.
        """
        under_way = self._builder.build
        if under_way is not None and not any(under_way.batch in session.held for session in self._jobs):
            self._builder.stop()
            for session in self._jobs:
                session.release(under_way.batch)
        if self._builder.build is not None or self._is_ending:
            return
        for session in self._jobs:
            if session.waiting(Build):
                self._builder.start(session.job, session.begin(Build))
                return

    def _answer_build(self, ended: BuildEnded) -> None:
        session = self._jobs.get(ended.job)
        if not self._builder.on_ended(ended) or session is None:
            return
        if ended.build.batch in session.held:
            answer = ended.message(self.wid, self._key)
            key = Keys(ended.job).result(self.wid)
            self._bus.put(key, messages.encode(answer), encoding=messages.encoding(type(answer)))
        session.release(ended.build.batch)

    def _next_batch(self) -> BatchProgress | None:
        """The next batch whose scene is here: first those begun before, then by turns of the jobs."""
        while (task := self._simulator.next_requeued) is not None:
            if self._is_wanted(task):
                return task if self._has_scene(task.job, task.work.scene) else None
            self._simulator.drop(task)
            self._release(task)
        session = None if self._is_ending else self._jobs.next_session(self._is_servable)
        return None if session is None else BatchProgress(session.job, session.begin(Work))

    def _is_servable(self, session: JobSession) -> bool:
        waiting = session.waiting(Work)
        return bool(waiting) and self._has_scene(session.job, waiting[0].scene)

    def _has_scene(self, job: str, scene: str) -> bool:
        """Return whether a batch of a scene can be submitted; a scene that is not here is requested."""
        if self._simulator.has_scene(scene) or self._simulator.is_fatal(scene) or scene in self._scenes:
            return True
        if scene not in self._requested:
            self._requested.add(scene)
            self._requests.fetch(job, scene)
        return False

    def _is_wanted(self, task: BatchProgress) -> bool:
        session = self._jobs.get(task.job)
        return session is not None and task.work.batch in session.held

    def _finish(self, task: BatchProgress) -> None:
        if self._is_wanted(task):
            result = task.result(self.wid, self._key)
            key = Keys(task.job).result(self.wid)
            self._bus.put(key, messages.encode(result), encoding=messages.encoding(type(result)))
        self._release(task)

    def _hand_back(self, task: BatchProgress, now: float) -> None:
        """Let a batch go; the next join, which does not list it, has it evaluated elsewhere."""
        self._release(task)
        if (session := self._jobs.get(task.job)) is not None:
            session.join_later(now, jitter())

    def _hand_back_all(self, now: float) -> None:
        last = self._last_batch
        for session in self._jobs:
            if session.has_coordinator and session.held:
                session.hand_back(keep=last.work.batch if last else None)
                session.join_soon(now)
                self._uninformed.add(session.job)

    def _release(self, task: BatchProgress) -> None:
        if task is self._last_batch:
            self._last_batch = None
        if (session := self._jobs.get(task.job)) is not None:
            session.release(task.work.batch)

    def _send_heartbeat(self, *, has_run: bool) -> None:
        """Publish memory and progress of this worker: progress keeps its lease from passing."""
        head = self._simulator.head
        heartbeat = Heartbeat(
            wid=self.wid,
            host=shorten(socket.gethostname()),
            run=head.work.run if head else "",
            rows=head.work.n if head else 0,
            done=head.done if head else 0,
            loading=head is not None and head.is_loading,
            progressed=(has_run and head is not None) or self._builder.build is not None,
            memory=self._simulator.memory + process_stats(os.getpid()).memory,
            restarts=self._simulator.restarts,
        )
        payload = msgspec.json.encode(heartbeat)
        for session in self._jobs:
            key = Keys(session.job).stat(f"worker/{self.wid}")
            self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)
