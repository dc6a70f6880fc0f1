"""The watch over a whole simulation: holds what happens to the invariants.

It keeps books of its own: what it compares with is the undisturbed journal, and what it saw going in and out.
"""

from tests.simulation.coordinator import Coordinator
from tests.simulation.invariants import require
from tests.simulation.recorder import Recorder
from tests.simulation.stage import Stage
from tests.simulation.turn_watch import TurnWatch
from tests.simulation.worker import CREDIT, Worker

from qdgrasp_coordinator.recording import intake
from qdgrasp_coordinator.recording.books import Books
from qdgrasp_coordinator.recording.intake import Arrival
from qdgrasp_coordinator.serving import outbox
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.outbox import Outbox
from qdgrasp_coordinator.serving.recorder_link import RecorderLink
from qdgrasp_protocol.messages import Recordable, Recorded
from qdgrasp_worker.serving.desk import Desk

PATIENCE, LOSSY_PATIENCE = 150.0, 900.0
"""Seconds of calm in which a row must have been recorded; where messages are lost, leases must pass first."""
SETTLED_DOWN = 45.0
"""Seconds of calm after which only those are remembered who are there."""


class Watch:
    """Watches a whole stage."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._turns: dict[str, TurnWatch] = {}
        self._checked: dict[str, int] = {}
        """Stretches on the disk that were compared, by run."""
        self._pushed: dict[Lane, int] = {}
        self._epochs: set[int] = set()
        self._listed: dict[str, tuple[int, set[bytes]]] = {}
        """The number of each worker's last join, and what it listed then."""
        self._rows = 0
        """Rows on the disk."""
        self._rows_at_progress = 0
        self._progress = 0.0
        stage.watch = self

    def began(self, host: Coordinator) -> None:
        """Hear that a turn begins."""
        epoch = host.turn.epoch
        if not self._stage.disk.was_restored:
            require(epoch not in self._epochs, "epochs rise", f"{epoch} is used twice")
        self._epochs.add(epoch)
        self._turns[host.name] = TurnWatch(host, self._stage.task)

    def opened(self, books: Books) -> None:
        """Hear that a recorder keeps the books; watches what it takes."""
        take = books.take

        def taken(message: Recordable, now: float) -> Arrival:
            epoch, arrival = books.epoch, take(message, now)
            is_old = arrival is Arrival.TAKEN and message.epoch < epoch
            require(not is_old, "epochs rise", f"rows of epoch {message.epoch} are taken in {epoch}")
            return arrival

        books.take = taken  # type: ignore[method-assign]

    def reported(self, report: Recorded) -> None:
        """Hear what a recorder reports."""
        durable = self._stage.disk.counts().get(report.run, 0)
        require(report.durable <= durable, "acknowledged when durable", report.durable, "of", durable)

    def look(self) -> None:
        """Check everything that the last event touched."""
        for process in dict.fromkeys(self._stage.world.touched):
            match process:
                case Coordinator():
                    self._stage.is_done |= process.is_done
                    if not process.is_over:
                        self._look_at_coordinator(process)
                case Recorder():
                    self._look_at_disk()
                    self._rows = sum(self._stage.disk.counts().values())
                    self._look_at_recorder(process)
                case Worker(is_over=False):
                    self._look_at_worker(process)
        self._look_at_progress()

    def _look_at_disk(self) -> None:
        size, disk = self._stage.task.shape.dtype.itemsize, self._stage.disk
        for run, paper in disk.papers.items():
            done = min(self._checked.get(run, 0), len(paper.stretches))
            for place in range(done, len(paper.stretches)):
                stretch = paper.stretches[place]
                before = paper.stretches[place - 1].stop if place else 0
                require(stretch.first == before, "true journal", f"{run}: {stretch.first} behind {before}")
                expected = self._stage.journals[run][stretch.first * size : stretch.stop * size]
                require(
                    stretch.rows.tobytes() == expected, "true journal", f"{run}: rows from {stretch.first}"
                )
                if not disk.was_restored:
                    lower = place and paper.epochs[place] < paper.epochs[place - 1]
                    require(not lower, "epochs rise", paper.epochs[place - 1 : place + 1])
                    require(
                        paper.epochs[place] <= disk.epoch, "epochs rise", paper.epochs[place], "is not stored"
                    )
            self._checked[run] = len(paper.stretches)

    def _look_at_coordinator(self, coordinator: Coordinator) -> None:
        for lane in coordinator.lanes:
            self._look_at_lane(lane)
        watch = self._turns.get(coordinator.name)
        if watch is None:
            return
        watch.look()
        watch.look_at_bounds()
        if self._stage.calm_seconds > SETTLED_DOWN and coordinator.is_running:
            watch.look_at_members({worker.wid for worker in self._stage.of(Worker)})

    def _look_at_lane(self, lane: Lane) -> None:
        """Check what the outbox keeps."""
        assert isinstance(lane.record, RecorderLink)
        box, plan = lane.record._outbox, self._stage.plans[lane.run]
        size = self._stage.task.shape.dtype.itemsize
        most = plan.in_flight * plan.population * (1 + plan.trials)
        require(box.unconfirmed <= outbox.BOUND + most, "bounded memory", "outbox:", box.unconfirmed)
        require(
            len(lane.pipeline._reasons) <= most, "bounded memory", "reasons:", len(lane.pipeline._reasons)
        )
        durable = self._stage.disk.papers[lane.run].count
        if not self._stage.disk.was_restored:
            kept = durable if not box._kept else box._kept[0].first
            require(
                kept <= durable, "recorded before forgotten", f"{kept} is forgotten, {durable} are durable"
            )
        _look_at_kept(box)
        for stretch in box._kept if self._pushed.get(lane) != box._end else ():
            expected = self._stage.journals[lane.run][stretch.first * size : stretch.stop * size]
            require(stretch.rows.tobytes() == expected, "told in order", f"{lane.run}: from {stretch.first}")
        self._pushed[lane] = box._end

    def _look_at_recorder(self, recorder: Recorder) -> None:
        for ledger in recorder.books._ledgers.values() if recorder.books else ():
            waiting = ledger.intake.expected - ledger.intake.durable
            require(waiting <= intake.CAPACITY, "bounded memory", "intake:", waiting)
        if recorder.scribe is not None:
            reports = recorder.scribe._reports
            require(set(reports._due) <= set(self._stage.plans), "bounded memory", "reports")

    def _look_at_worker(self, worker: Worker) -> None:
        desk = worker.desk
        if desk is None:
            return
        self._look_at_fence(worker, desk)
        held = len(desk.held)
        if held > CREDIT and not self._stage.is_lossy:
            unknown = sum(watch.taken_back[worker.wid] for watch in self._turns.values())
            require(held <= CREDIT + unknown, "bounded work", worker.name, f"holds {held}")
        known = {task.work.batch for task in worker.workshop.tasks} | set(desk.held)
        require(desk._begun <= known, "bounded memory", worker.name, "remembers batches that are gone")

    def _look_at_fence(self, worker: Worker, desk: Desk) -> None:
        number, listed = self._listed.get(worker.wid, (0, set()))
        if number != desk.number:
            number, listed = self._listed[worker.wid] = (desk.number, set(desk.held))
        for batch, work in desk._held.items():
            is_fenced = work.join == number or batch in listed
            require(is_fenced, "fenced", worker.name, "holds work of join", work.join, "of", number)
            require(work.epoch == desk.epoch, "fenced", worker.name, "holds work of epoch", work.epoch)

    def _look_at_progress(self) -> None:
        stage, now = self._stage, self._stage.world.now
        if self._rows != self._rows_at_progress or not stage.is_calm:
            self._rows_at_progress, self._progress = self._rows, now
        patience = LOSSY_PATIENCE if stage.is_lossy else PATIENCE
        require(now - self._progress < patience, "progress", f"{self._rows} rows since {self._progress:.1f}")


def _look_at_kept(box: Outbox) -> None:
    """Check that the outbox keeps everything behind what is confirmed, without a gap."""
    stop = box._kept[0].first if box._kept else box._end
    require(stop <= box.confirmed or not box.unconfirmed, "recorded before forgotten", stop, box.confirmed)
    for stretch in box._kept:
        require(stretch.first == stop, "recorded before forgotten", "a gap at", stop)
        stop = stretch.stop
    require(stop == box._end, "recorded before forgotten", "the end is missing:", stop, box._end)
