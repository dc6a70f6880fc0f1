"""A whole simulation: its world, its processes, their restarts, and its checks."""

import hashlib
from collections import Counter
from collections.abc import Iterable
from functools import lru_cache
from math import inf
from typing import TypeVar

from tests.coordinator.scheduler.search_plans import Plan, Task, reference
from tests.simulation.coordinator import Coordinator
from tests.simulation.invariants import CheckedSearch, require
from tests.simulation.network import Network, World
from tests.simulation.plan import History
from tests.simulation.process import Process
from tests.simulation.recorder import MemoryDisk, SimulatedRecorder
from tests.simulation.worker import CREDIT, Forger, RandomFailures, Speed, Worker

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.recorder import run_writer
from qdgrasp_coordinator.recorder.recorder import Recorder
from qdgrasp_coordinator.scheduler import batch_dispatcher, recorder_client
from qdgrasp_coordinator.scheduler.batch_dispatcher import Lease, SettleReply, ShapeBuild
from qdgrasp_coordinator.scheduler.batch_queue import Probe, RunRef
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.recorder_client import Outbox, RecorderClient
from qdgrasp_coordinator.scheduler.run_plan import BuildReply, RunPlan
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun
from qdgrasp_coordinator.scheduler.worker_registry import (
    SCENES_KEPT,
    TOKEN_DELAY,
    TOKEN_GRACE,
    TURNAROUNDS_KEPT,
    LostWorker,
)
from qdgrasp_protocol.build_messages import Built, ShapeTask
from qdgrasp_protocol.messages import Join, Recordable, Recorded, Result
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.runtime.job_registry import JobSession

RESTART_INTERVAL = 1.0
"""Seconds between two checks for processes that have ended."""
P = TypeVar("P", bound=Process)


@lru_cache(maxsize=256)
def journal_of(plan: Plan) -> bytes:
    """The journal of an undisturbed run."""
    return reference(plan)


class Simulation:
    """All processes of a history."""

    def __init__(self, history: History) -> None:
        self.history = history
        self.world = World(history.number)
        self.network = Network(self.world, history.quality)
        self.disk = MemoryDisk()
        self.failures = RandomFailures(self.world.chance, history.failure_rate)
        self.processes: list[Process] = []
        self.task = history.runs[0].task
        """The search and evaluation, the same in all runs."""
        is_single = len(history.runs) == 1 and not history.has_shapes
        names = ["run"] if is_single else [f"run-{n}" for n in range(len(history.runs))]
        self.plans = dict(zip(names, history.runs, strict=True))
        self.journals = {run: journal_of(plan) for run, plan in self.plans.items()}
        """The journal that each run is to have."""
        self.lengths = {
            run: len(journal) // self.task.shape.dtype.itemsize for run, journal in self.journals.items()
        }
        self.built: set[str] | None = set() if history.has_shapes else None
        """Runs whose shapes lie in the store; None: runs need none."""
        self.is_done = False
        """A coordinator has carried out all runs."""
        self.is_calm = False
        """Nothing goes wrong any more."""
        self.calm_since = inf
        self.checker: SimulationChecker
        """Set by the checker itself."""
        self._started = 0
        if history.is_embedded:
            self.network.go_down()

    def open(self) -> None:
        """Start the processes of the beginning, in any order."""
        workers, is_bad_first = [self.start_worker] * self.history.workers, self.history.bad_first
        for start in [self.start_recorder, self.start_coordinator, *([] if is_bad_first else workers)]:
            self.world.later(self.world.chance.uniform(0, 2), start)
        for kind in self.history.bad:
            if is_bad_first:
                self.start_worker(kind)
            else:
                self.world.later(self.world.chance.uniform(4, 8), lambda kind=kind: self._start_bad(kind))
        for start in workers if is_bad_first else ():
            self.world.later(self.world.chance.uniform(1, 2), start)
        self.world.later(2.0, self._restart_ended)

    # Progress.

    @property
    def is_over(self) -> bool:
        """All runs are on the disk, and a coordinator knows."""
        return self.is_done and self.is_recorded

    @property
    def is_recorded(self) -> bool:
        """All runs are on the disk."""
        return self.disk.counts() == self.lengths

    @property
    def calm_seconds(self) -> float:
        """Seconds in which nothing went wrong."""
        return max(0.0, self.world.now - self.calm_since)

    @property
    def is_lossy(self) -> bool:
        """Messages are lost, repeated or overtaken even on links that hold."""
        quality = self.history.quality
        repeats = quality.repeat or "old messages are repeated" in self.history.faults
        return bool(quality.loss or repeats or quality.stall or not quality.in_order)

    # The processes that are there.

    def of(self, kind: type[P], *, living: bool = True) -> list[P]:
        """The processes of a kind."""
        return [p for p in self.processes if isinstance(p, kind) and not (living and p.is_over)]

    def some(self, kind: type[P]) -> P | None:
        """Return any running process of a kind, or None."""
        running = [process for process in self.of(kind) if process.is_running]
        return self.world.chance.choice(running) if running else None

    # Processes are started.

    def start_forger(self) -> None:
        """Start a process that forges results."""
        self.processes.append(Forger(self.world, self.network, f"{self._next():032x}"))

    def _start_bad(self, kind: str) -> None:
        """Start a bad worker once two good ones have joined."""
        coordinator = self.some(Coordinator)
        if coordinator is None or len(coordinator.scheduler.workers) < 2:
            self.world.later(RESTART_INTERVAL, lambda: self._start_bad(kind))
        else:
            self.start_worker(kind)

    def start_worker(self, bad: str = "") -> None:
        """Start a worker on a machine that may be slow."""
        history, wid = self.history, f"{self._next():032x}"
        slowness = history.spread ** self.world.chance.random()
        speed = Speed(
            history.row_seconds * slowness / history.spread**0.5, self.world.chance.choice([1, 2, 16])
        )
        builds = int(wid, 16) % 10 < 10 * history.builders
        self.processes.append(
            Worker(self.world, self.network, wid, self.task, self.failures, speed, builds=builds, bad=bad)
        )

    def start_recorder(self) -> None:
        """Start a recorder; while another one holds the folder it waits."""
        name = f"recorder {self._next()}"
        recorder = SimulatedRecorder(
            self.world,
            self.network,
            name,
            self.disk,
            self.history.latency,
            opened=self.checker.opened,
            reports=self.checker.reported,
        )
        self.processes.append(recorder)

    def start_coordinator(self) -> None:
        """Start a coordinator; the router may be in it."""
        if self.history.is_embedded:
            if self.of(Coordinator):
                return
            self.network.come_up()
        name = f"coordinator {self._next()}"
        coordinator = Coordinator(
            self.world,
            self.network,
            name,
            list(self.plans),
            self._plan,
            self.history.batch_size,
            on_epoch=self.checker.began,
            built=self.built,
        )
        coordinator.session.is_local = self.history.is_embedded
        self.processes.append(coordinator)

    def _next(self) -> int:
        self._started += 1
        return self._started

    def _plan(self, run: str) -> RunPlan:
        """A run, with a new search."""
        plan, digest = self.plans[run], hashlib.sha256(run.encode()).hexdigest()
        spec = RunSpec(gripper="hand", object="thing", seed=plan.seed, evaluations=plan.evaluations)
        search = CheckedSearch(plan.task.search(plan.population, plan.seed), plan.spec)
        pipeline = plan.pipeline_of(search)
        return RunPlan(run, spec, Bundle(b"", digest), "none", self.task.shape, pipeline)

    # Processes that have ended are started again.

    def _restart_ended(self) -> None:
        """Start processes that have ended again, as init systems and people do."""
        chance = self.world.chance
        if not self.of(SimulatedRecorder) and chance.random() < 0.5:
            self.start_recorder()
        if not self.of(Coordinator):
            if self.history.is_embedded:
                self.network.go_down()
            if chance.random() < 0.5:
                self.start_coordinator()
        wanted = 1 if self.is_calm else self.history.workers
        if len(self.of(Worker)) < wanted and chance.random() < 0.4:
            self.start_worker()
        self.world.later(RESTART_INTERVAL, self._restart_ended)


Key = tuple[str, int, int, int]
"""A row: run, generation, index, trial."""


class DispatchChecker:
    """Watches the dispatch of one epoch: what goes in, and what comes out."""

    def __init__(self, host: Coordinator, task: Task) -> None:
        self._host = host
        self._task = task
        self._leased: dict[bytes, set[str]] = {}
        self._settled: set[bytes] = set()
        self.outstanding: set[Key] = set()
        """Rows that were asked and are not settled."""
        self.taken_back: Counter[str] = Counter()
        """Batches that were taken back, by worker: it may not know."""
        self._dispatch, self._workers = host.scheduler.dispatcher, host.scheduler.workers
        self.builds: set[str] = set()
        """Keys of shapes that were asked for and are not settled."""
        for name in ("submit", "withdraw", "leases", "settle"):
            self._wrap(self._dispatch, name)
        for name in ("build", "settle_build", "withdraw_builds", "give_up_build"):
            self._wrap(self._dispatch, name)
        self._joined: dict[str, float] = {}
        """When the latest join without its token was heard, by worker: that token may be late."""
        for name in ("join", "overdue"):
            self._wrap(self._workers, name)

    def _wrap(self, owner: object, name: str) -> None:
        setattr(self, f"_real_{name}", getattr(owner, name))
        setattr(owner, name, getattr(self, f"_{name}"))

    def _submit(self, run: RunRef, generation: Generation) -> None:
        keys = _keys(run.run, generation)
        require(self.outstanding.isdisjoint(keys), "nothing is lost", "asked twice:", keys)
        self.outstanding.update(keys)
        self._real_submit(run, generation)

    def _withdraw(self, run: str, *, audits: bool = True) -> dict[str, list[bytes]]:
        self.outstanding = {key for key in self.outstanding if key[0] != run}
        drops = self._real_withdraw(run, audits=audits)
        self.taken_back.update({wid: len(batches) for wid, batches in drops.items()})
        return drops

    def _leases(self, now: float) -> list[Lease]:
        leases = self._real_leases(now)
        for lease in leases:
            require(lease.task.id not in self._settled, "settled once", "leased again:", lease.task.id.hex())
            worker = self._workers._workers[lease.wid]
            held = len(worker.batches)
            require(held <= CREDIT, "bounded work", "worker", lease.wid, "is leased", held)
            if isinstance(lease.task, ShapeBuild):
                builds = sum(worker.batches.values())
                require(builds == 1, "bounded work", "worker", lease.wid, "has another build")
            else:
                require(not worker.is_building, "bounded work", "worker", lease.wid, "builds a shape")
            self._leased.setdefault(lease.task.id, set()).add(lease.wid)
            self._host.note(
                f"leases {lease.task.id.hex()[-4:]} to worker {int(lease.wid, 16)}, join {lease.join}"
            )
        if self._dispatch.trouble:  # all rows fail, and are tried now and then
            return leases
        waits = any(waiting for waiting in self._dispatch._queue._runs.values())
        workers = list(self._workers)
        is_any_well = any(worker.is_well for worker in workers)
        free = [worker.wid for worker in workers if worker.has_credit and (worker.is_well or not is_any_well)]
        require(not (waits and free), "work is handed out", "nothing is leased to", free)
        for batch in self._dispatch._queue._again.values():
            may = [w.wid for w in workers if w.wid in free and self._dispatch._may_have(w, batch, now)]
            require(not may, "work is handed out", "no failed row is leased to", may)
        return leases

    def _settle(self, wid: str, result: Result, rows: Rows, now: float) -> SettleReply | None:
        settled = self._real_settle(wid, result, rows, now)
        self._host.note(
            f"hears {result.batch.hex()[-4:]} of worker {int(wid, 16)}: {'fresh' if settled else 'dropped'}"
        )
        holder = self._workers.get(wid)
        is_free = holder is None or result.batch not in holder.batches
        require(is_free or result.epoch != self._host.scheduler.epoch, "nothing is lost", "still held:", wid)
        if settled is None:
            return None
        batch = result.batch
        require(batch not in self._settled, "settled once", "again:", batch.hex())
        require(wid in self._leased.get(batch, ()), "settled once", "by", wid, "who was not leased it")
        self._settled.add(batch)
        self._check_rows(result.run, settled.rows)
        return settled

    def _build(self, tasks: Iterable[ShapeTask]) -> None:
        asked = list(tasks)
        keys = {task.key for task in asked}
        require(self.builds.isdisjoint(keys) and len(keys) == len(asked), "nothing is lost", "built twice")
        self.builds |= keys
        self._real_build(asked)

    def _settle_build(self, wid: str, built: Built, now: float) -> BuildReply | None:
        reply = self._real_settle_build(wid, built, now)
        if reply is not None:
            require(built.batch not in self._settled, "settled once", "again:", built.batch.hex())
            require(wid in self._leased.get(built.batch, ()), "settled once", "by", wid, "not leased it")
            require(reply.key in self.builds, "settled once", "no run waits for", reply.key)
            self._settled.add(built.batch)
            self.builds.remove(reply.key)
        return reply

    def _withdraw_builds(self) -> dict[str, list[bytes]]:
        self.builds.clear()
        return self._real_withdraw_builds()

    def _give_up_build(self) -> ShapeTask | None:
        task = self._real_give_up_build()
        self.builds -= {task.key} if task else set()
        return task

    def _check_rows(self, run: str, rows: Rows) -> None:
        asked = self._task.shape.empty(len(rows))
        for column in ("generation", "index", "trial", "genome"):
            asked[column] = rows[column]
        require(
            self._task.evaluate(asked).tobytes() == rows.tobytes(), "settled once", "with other rows:", rows
        )
        keys = set(
            zip([run] * len(rows), *(rows[c].tolist() for c in ("generation", "index", "trial")), strict=True)
        )
        require(keys <= self.outstanding, "settled once", "nobody waits for", keys - self.outstanding)
        self.outstanding -= keys

    def _join(self, join: Join, now: float) -> list[bytes] | None:
        if join.wid not in self._workers.alive:
            self._joined[join.wid] = now
        return self._real_join(join, now)

    def _overdue(self, now: float) -> list[LostWorker]:
        lost = self._real_overdue(now)
        for one in lost:
            self._host.note(f"gives worker {int(one.worker.wid, 16)} up: {one.reason}")
        require(not lost or self._host.link_is_up, "patience while cut off", lost)
        for one in lost:
            self.taken_back[one.worker.wid] += len(one.batches)
        return lost

    # After every event.

    def check(self) -> None:
        """Check where all batches are."""
        workers = self._workers._workers
        places: list[Key] = []
        for run, waiting in self._dispatch._queue._runs.items():
            for rows in (*waiting.uncut, *(batch.rows for batch in waiting.again.values())):
                places += _keys(run, rows)
        for batch in self._dispatch._queue._again.values():
            places += [] if isinstance(batch, Probe) else _keys(batch.run.run, batch.rows)
        held: dict[str, set[bytes]] = {wid: set() for wid in workers}
        builds = [build.task.key for build in self._dispatch._builds]
        for task in self._dispatch._open.values():
            if not task.holders:
                continue
            for holder in task.holders:
                held.setdefault(holder, set()).add(task.id)
            if isinstance(task, ShapeBuild):
                builds.append(task.task.key)
            elif not isinstance(task, Probe):
                places += _keys(task.run.run, task.rows)
        require(sorted(builds) == sorted(self.builds), "nothing is lost", "builds:", builds, self.builds)
        require(len(places) == len(set(places)), "nothing is lost", "a row is in two places")
        require(
            set(places) == self.outstanding, "nothing is lost", self.outstanding.symmetric_difference(places)
        )
        for wid, batches in held.items():
            known = set(workers[wid].batches) if wid in workers else set()
            known = {batch for batch in known if batch in self._dispatch._open}  # others were faster with it
            require(
                batches == known, "nothing is lost", wid, "is leased", batches, "and known to hold", known
            )

    def check_bounds(self) -> None:
        """Check credit, and how much is remembered."""
        for worker in self._workers:
            require(len(worker.scenes) <= SCENES_KEPT, "bounded memory", "scenes")
        batches, timeout = self._dispatch, self._workers.lease_timeout
        most = len(self.outstanding) + len(self.builds) + 1  # a row of before, to see whether all fail
        require(len(batches._open) <= most, "bounded memory", "open batches")
        require(len(batches._settled) <= batch_dispatcher.MOST_SETTLED, "bounded memory", "settled batches")
        require(len(timeout._turnarounds) <= TURNAROUNDS_KEPT, "bounded memory", "turnarounds")
        open_runs = {run.name for run in self._host.scheduler.runs}
        require(set(self._dispatch._queue._runs) <= open_runs, "bounded memory", "rows of finished runs")

    def check_workers(self, living: set[str]) -> None:
        """Check that only workers that are there are remembered, or whose tokens may be late."""
        lately = self._host.now - TOKEN_DELAY - TOKEN_GRACE
        known = {wid for wid in self._workers._workers if self._joined.get(wid, -inf) < lately}
        gone = known - living
        require(not gone, "bounded memory", "workers that are gone:", gone)
        gone = self._workers.alive - living
        require(not gone, "bounded memory", "tokens that are gone:", gone)


def _keys(run: str, rows: Generation) -> list[Key]:
    return [
        (run, rows.number, index, trial)
        for index, trial in zip(rows.indices.tolist(), rows.trials.tolist(), strict=True)
    ]


PATIENCE, LOSSY_PATIENCE = 150.0, 900.0
"""Seconds of calm in which a row must be recorded; on lossy links leases must pass first."""
SETTLED_DOWN = 45.0
"""Seconds of calm after which only present workers are remembered, and those that asked to join lately."""


class SimulationChecker:
    """Checks a whole simulation after every event."""

    def __init__(self, stage: Simulation) -> None:
        self._stage = stage
        self._dispatches: dict[str, DispatchChecker] = {}
        self._checked: dict[str, int] = {}
        """Slices on the disk that were compared, by run."""
        self._pushed: dict[ActiveRun, int] = {}
        self._epochs: set[int] = set()
        self._listed: dict[str, tuple[int, set[bytes]]] = {}
        """The number of each worker's last join, and what it listed then."""
        self._rows = 0
        """Rows on the disk."""
        self._rows_at_progress = 0
        self._progress = 0.0
        stage.checker = self

    def began(self, host: Coordinator) -> None:
        """Watch a dispatcher as its epoch begins."""
        epoch = host.scheduler.epoch
        if not self._stage.disk.was_restored:
            require(epoch not in self._epochs, "epochs rise", f"{epoch} is used twice")
        self._epochs.add(epoch)
        self._dispatches[host.name] = DispatchChecker(host, self._stage.task)

    def opened(self, recorder: Recorder) -> None:
        """Watch the rows that a recorder takes."""
        add_rows = recorder.add_rows

        def added(message: Recordable, now: float) -> bool:
            epoch, arrival = recorder.epoch, add_rows(message, now)
            is_old = arrival and message.epoch < epoch
            require(not is_old, "epochs rise", f"rows of epoch {message.epoch} are taken in {epoch}")
            return arrival

        recorder.add_rows = added  # type: ignore[method-assign]

    def reported(self, report: Recorded) -> None:
        """Check a recorder's report."""
        durable = self._stage.disk.counts().get(report.run, 0)
        require(report.durable <= durable, "acknowledged when durable", report.durable, "of", durable)

    def check(self) -> None:
        """Check everything that the last event touched."""
        for process in dict.fromkeys(self._stage.world.touched):
            match process:
                case Coordinator():
                    self._stage.is_done |= process.is_done
                    if not process.is_over:
                        self._check_coordinator(process)
                case SimulatedRecorder():
                    self._check_disk()
                    self._rows = sum(self._stage.disk.counts().values())
                    self._check_recorder(process)
                case Worker(is_over=False):
                    self._check_worker(process)
        self._check_progress()

    def _check_disk(self) -> None:
        size, disk = self._stage.task.shape.dtype.itemsize, self._stage.disk
        for run, file in disk.files.items():
            done = min(self._checked.get(run, 0), len(file.slices))
            for place in range(done, len(file.slices)):
                part = file.slices[place]
                before = file.slices[place - 1].stop if place else 0
                require(part.first == before, "true journal", f"{run}: {part.first} behind {before}")
                expected = self._stage.journals[run][part.first * size : part.stop * size]
                require(part.rows.tobytes() == expected, "true journal", f"{run}: rows from {part.first}")
                if not disk.was_restored:
                    lower = place and file.epochs[place] < file.epochs[place - 1]
                    require(not lower, "epochs rise", file.epochs[place - 1 : place + 1])
                    require(
                        file.epochs[place] <= disk.epoch, "epochs rise", file.epochs[place], "is not stored"
                    )
            self._checked[run] = len(file.slices)

    def _check_coordinator(self, coordinator: Coordinator) -> None:
        for run in coordinator.scheduler.runs:
            self._check_run(run)
        checker = self._dispatches.get(coordinator.name)
        if checker is None:
            return
        checker.check()
        checker.check_bounds()
        if self._stage.calm_seconds > SETTLED_DOWN and coordinator.is_running:
            checker.check_workers({worker.wid for worker in self._stage.of(Worker)})

    def _check_run(self, run: ActiveRun) -> None:
        """Check what the outbox keeps."""
        assert isinstance(run.sink, RecorderClient)
        box, plan = run.sink, self._stage.plans[run.name]
        size = self._stage.task.shape.dtype.itemsize
        most = max(plan.in_flight, plan.most_in_flight) * plan.population * (1 + plan.trials)
        limit = recorder_client.MOST_UNCONFIRMED + most
        require(box.unconfirmed <= limit, "bounded memory", "outbox:", box.unconfirmed)
        require(len(run.pipeline._reasons) <= most, "bounded memory", "reasons:", len(run.pipeline._reasons))
        durable = self._stage.disk.files[run.name].count
        if not self._stage.disk.was_restored:
            kept = durable if not box._kept else box._kept[0].first
            require(
                kept <= durable, "recorded before forgotten", f"{kept} is forgotten, {durable} are durable"
            )
        _check_kept(box)
        for part in box._kept if self._pushed.get(run) != box._end else ():
            expected = self._stage.journals[run.name][part.first * size : part.stop * size]
            require(part.rows.tobytes() == expected, "told in order", f"{run.name}: from {part.first}")
        self._pushed[run] = box._end

    def _check_recorder(self, recorder: SimulatedRecorder) -> None:
        if recorder.recorder is not None:
            for writer in recorder.recorder.writers.values():
                waiting = writer.expected - writer.durable
                require(waiting <= run_writer.MOST_WAITING, "bounded memory", "rows that wait:", waiting)
            require(recorder.recorder._news <= set(self._stage.plans), "bounded memory", "reports")

    def _check_worker(self, worker: Worker) -> None:
        session = worker.session_of_job
        if session is None:
            return
        self._check_fence(worker, session)
        held = len(session.held)
        if held > CREDIT and not self._stage.is_lossy:
            unknown = sum(checker.taken_back[worker.wid] for checker in self._dispatches.values())
            require(held <= CREDIT + unknown, "bounded work", worker.name, f"holds {held}")
        tasks = [*worker.supervisor._requeued, *worker.supervisor._sent]
        known = {task.work.batch for task in tasks} | set(session.held)
        under_way = worker.service._builder.build
        known |= {under_way.batch} if under_way else set()
        require(session._begun <= known, "bounded memory", worker.name, "remembers batches that are gone")

    def _check_fence(self, worker: Worker, session: JobSession) -> None:
        number, listed = self._listed.get(worker.wid, (0, set()))
        if number != session.number:
            number, listed = self._listed[worker.wid] = (session.number, set(session.held))
        for batch, work in session._held.items():
            is_fenced = work.join == number or batch in listed
            require(is_fenced, "fenced", worker.name, "holds work of join", work.join, "of", number)
            require(work.epoch == session.epoch, "fenced", worker.name, "holds work of epoch", work.epoch)

    def _check_progress(self) -> None:
        stage, now = self._stage, self._stage.world.now
        if self._rows != self._rows_at_progress or not stage.is_calm:
            self._rows_at_progress, self._progress = self._rows, now
        patience = LOSSY_PATIENCE if stage.is_lossy else PATIENCE
        require(now - self._progress < patience, "progress", f"{self._rows} rows since {self._progress:.1f}")


def _check_kept(box: Outbox) -> None:
    """Check that the outbox keeps everything behind what is confirmed, without a gap."""
    stop = box._kept[0].first if box._kept else box._end
    require(stop <= box.durable or not box.unconfirmed, "recorded before forgotten", stop, box.durable)
    for part in box._kept:
        require(part.first == stop, "recorded before forgotten", "a gap at", stop)
        stop = part.stop
    require(stop == box._end, "recorded before forgotten", "the end is missing:", stop, box._end)
