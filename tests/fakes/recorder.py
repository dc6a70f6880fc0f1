"""A coordinator as a recorder sees it, and recorders to be seen by it."""

import hashlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from msgspec import structs
from tests.common import PATIENCE, wait_for
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.messages import open_run, put
from tests.fakes.service_thread import ServiceThread

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.recorder.recorder_service import RecorderService
from qdgrasp_coordinator.storage.journal import JournalSlice, slice_from_message, slice_to_message
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Message, Open, Opened, OpenRun, Recordable, Recorded
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_tools.monitor.queries import QueryServer

SHAPE = RowShape(genes=7, joints=2)
SPEC = RunSpec(gripper="panda", object="mug", evaluations=1000)
SCENE = b"a scene" * 200_000
BUNDLE = Bundle(SCENE, hashlib.sha256(SCENE).hexdigest())
JOB = "mugs"


def make_rows(n: int) -> Rows:
    rows = SHAPE.empty(n)
    random = np.random.default_rng(0)
    rows["index"], rows["outcome"] = np.arange(n), random.integers(Outcome.ERROR, Outcome.HELD, n)
    rows["genome"] = random.uniform(-1, 1, rows["genome"].shape)
    return rows


def anonymous(opened: Opened) -> Opened:
    """The answer without the job's identity, which is random."""
    return structs.replace(opened, identity="")


class FakeCoordinator:
    """A coordinator as a recorder sees it."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._keys = Keys(JOB)
        self._reports: list[Recorded] = []
        self._recorder = threading.Event()
        self.epoch = 0
        bus.watch(
            self._keys.recorder_token(), lambda _, alive: (self._recorder.clear, self._recorder.set)[alive]()
        )
        bus.subscribe(
            self._keys.recorded, lambda s: self._reports.append(messages.decode(s.payload, Recorded))
        )

    def _take(self, sample: Sample) -> None:
        self._reports.append(messages.decode(sample.payload, Recorded))

    def open(self, toml: str = to_toml(SPEC), job: str = JOB, **changes: object) -> Opened:
        """Open the run as soon as a recorder is there."""
        return self._open(Open(job=job, runs=[self.question(toml, **changes)]))

    def open_runs(self, *runs: str, epoch: int = 0, **changes: object) -> Opened:
        """Open runs of a campaign as soon as a recorder is there."""
        questions = [self.question(run=run, **changes) for run in runs]
        return self._open(Open(job=JOB, runs=questions, epoch=epoch))

    def _open(self, question: Open) -> Opened:
        opened = messages.decode(self.ask(self._keys.open, messages.encode(question)), Opened)
        self.epoch = opened.epoch
        return opened

    def question(self, toml: str = to_toml(SPEC), **changes: object) -> OpenRun:
        """The query that opens the run."""
        return open_run(**{"spec": toml.encode(), "scene": BUNDLE.digest} | changes)

    def meet(self) -> None:
        """Wait until a recorder is there."""
        assert self._recorder.wait(PATIENCE), "no recorder came"

    def ask(self, key: str, payload: bytes) -> bytes:
        """Ask the recorder; one that is killed may still seem to be there for a moment."""
        deadline = time.monotonic() + PATIENCE
        while True:
            self.meet()
            try:
                return self._bus.ask(key, payload)
            except NoReply:
                assert time.monotonic() < deadline, "no recorder answered"

    def send(
        self, rows: Rows, first: int, stop: int, *, run: str = "run", epoch: int = 0, **beside: object
    ) -> None:
        part = JournalSlice(first, rows[first:stop], **beside)  # type: ignore[arg-type]
        self.put(slice_to_message(part, run, epoch or self.epoch, SHAPE, {"pybullet": "3.2.7"}))

    def put(self, message: Message) -> None:
        put(self._bus, self._keys.outcome(self.epoch), message)

    def page(self, first: int, limit: int, run: str = "run") -> JournalSlice:
        answer = self.ask(self._keys.log, messages.encode(Log(run=run, first=first, limit=limit)))
        return slice_from_message(messages.decode(answer, Recordable), SHAPE)

    def hears(self, condition: Callable[[Recorded], bool]) -> Recorded:
        """The first report of which the condition holds, of those that were not returned before."""
        report = wait_for(lambda: next(filter(condition, self._reports), None), "a report")
        assert report is not None
        self._reports.remove(report)
        return report

    def hears_durable(self, number: int, run: str = "run") -> Recorded:
        return self.hears(
            lambda report: (report.run, report.durable, report.epoch) == (run, number, self.epoch)
        )


@contextmanager
def recording(network: MemoryNetwork, path: Path, disk_wait: float = 60.0) -> Iterator[ServiceThread]:
    """A recorder until the context ends, by SIGTERM."""
    with network.session() as bus, QueryServer(bus, JOB, path):
        stop = Stop()
        service = RecorderService(bus, stop, job=JOB, path=path, disk_wait=disk_wait)
        running = ServiceThread(service.run, stop)
        try:
            yield running
        finally:
            running.leave()
            running.ends()
