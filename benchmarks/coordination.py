"""Cost of a genome in the coordinator and in the recorder, without the bus."""

import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from math import inf
from pathlib import Path

import numpy as np
from benchmarks.measure import Figure, Meter, StageTimer, TimedWork, measure_in_turns
from msgspec.structs import replace
from tests.coordinator.search import synthetic_scene
from tests.coordinator.search.synthetic_scene import plain

from qdgrasp_coordinator.recorder.recorder import Recorder, open_recorder
from qdgrasp_coordinator.scheduler.batch_dispatcher import Dispatcher
from qdgrasp_coordinator.scheduler.batch_queue import RunRef
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.scheduler.worker_registry import WorkerRegistry
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_coordinator.search.registry import AIMED, method
from qdgrasp_coordinator.storage.journal_schema import JournalIdentity
from qdgrasp_coordinator.storage.journal_slice import JournalSlice, slice_to_message
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_protocol import messages
from qdgrasp_protocol.messages import VERSION, Join, Open, OpenRun, Result, Work, deflated
from qdgrasp_protocol.rows import RESULT, Genomes, Outcome, Rows, RowShape, pack, unpack
from qdgrasp_protocol.spec import RunSpec, to_toml

SHAPE = RowShape(genes=7, joints=2)
WID = "0" * 32
METHODS = ("contact_rand", "contact_me_scs", "cma_mae", "aimed")
BATCH = 64


def measure_coordination(seconds: float) -> list[Figure]:
    return measure_in_turns(
        [TimedWork(f"coordinator, {name}", Coordinator(name)) for name in METHODS], seconds
    )


class TimedSearch:
    """A search whose CPU time is added up by stage."""

    def __init__(self, search: SearchAlgorithm, timer: StageTimer) -> None:
        self._search = search
        self._timer = timer

    def ask(self, generation: int) -> Genomes:
        with self._timer.within("ask"):
            return self._search.ask(generation)

    def tell(self, generation: int, rows: Rows) -> None:
        with self._timer.within("tell"):
            self._search.tell(generation, rows)


class Coordinator:
    """A coordinator's work on a run whose worker answers at once."""

    def __init__(self, name: str) -> None:
        chosen = method(name)
        aim_for = chosen.aim_for
        space = synthetic_scene.space(chosen.prior) if chosen is AIMED else plain(SHAPE.genes)
        spec = RunSpec(
            gripper="panda",
            object="mug",
            method=name,
            aim_for=aim_for,
            evaluations=10**9,
            population=chosen.population,
        )
        self._prior = chosen.prior
        self._shape = synthetic_scene.shape(space) if chosen is AIMED else SHAPE
        self._timer = StageTimer()
        with self._timer.within("ask"):
            search = TimedSearch(chosen.build(spec, space), self._timer)
            self._pipeline = Pipeline(search, self._shape, spec.evaluations, "count")
        self._timer.seconds.clear()
        self._layout = space.layout
        self._scale = 1.0 if chosen is AIMED else 0.2  # m, of what the first three genes stand for
        workers = WorkerRegistry()
        workers.on_token(WID, True, 0.0)
        self._dispatcher = Dispatcher(1, workers, BATCH)
        self._dispatcher.join(
            Join(
                versions=[VERSION],
                wid=WID,
                key=bytes(32),
                number=1,
                credit=8,
                held=[],
                host="here",
                pid=1,
                platform={},
            ),
            0.0,
        )

    def __call__(self, meter: Meter) -> float:
        """Have the next batches evaluated; returns the number of rows that became final."""
        before = self._pipeline.tally.rows
        with meter.running():
            sent = self._lease()
        for payload in sent:
            answer = self._worker(messages.decode(payload, Work))
            with meter.running():
                self._settle(answer)
        return self._pipeline.tally.rows - before

    def _lease(self) -> list[bytes]:
        with self._timer.within("pipeline"):
            asked = self._pipeline.ask()
        with self._timer.within("dispatch"):
            if asked is not None:
                self._dispatcher.submit(RunRef("run", "0" * 64, self._prior), asked)
            leases = self._dispatcher.leases(0.0)
        with self._timer.within("messages"):
            return [messages.encode(lease.work(1)) for lease in leases]

    def _settle(self, answer: bytes) -> None:
        with self._timer.within("messages"):
            result = messages.decode(answer, Result)
            rows = unpack(self._shape.empty(result.n), RESULT, result.columns)
        with self._timer.within("dispatch"):
            settled = self._dispatcher.settle(WID, result, rows, 0.0)
        if settled.rows is None:
            return
        with self._timer.within("pipeline"):
            final = self._pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures)
        with self._timer.within("messages"):
            messages.encode(slice_to_message(final, "run", 1, self._shape))

    @property
    def stages(self) -> dict[str, float]:
        """Microseconds of a genome by stage."""
        rows = self._pipeline.tally.rows
        return {name: 1e6 * seconds / rows for name, seconds in self._timer.seconds.items()}

    @property
    def remark(self) -> str:
        spent = ", ".join(f"{name} {time:.1f}" for name, time in self.stages.items())
        return f"{spent} us; {self._pipeline.tally.cells:,} cells at the end"

    def _worker(self, work: Work) -> bytes:
        """A result at once: the hand is where the first genes say, and succeeds in two of five places."""
        genomes = np.frombuffer(work.columns["genome"], "<f4").reshape(work.n, work.genes)
        rows = self._shape.empty(work.n)
        rows["descriptor"][:, :3] = self._scale * self._layout.values(genomes)[:, :3]
        rows["base_to_object"][:, 6] = 1.0
        noise = np.modf(1e4 * np.abs(rows["descriptor"]).sum(axis=1))[0]
        rows["outcome"] = np.where(noise < 0.4, Outcome.HELD, Outcome.OVERLAP)
        rows["fitness"] = np.maximum(rows["outcome"].astype(int) - Outcome.DROPPED, 0)
        return messages.encode(_result(work, self._shape, rows))


def _result(work: Work, shape: RowShape, rows: Rows) -> Result:
    return Result(
        epoch=1,
        run=work.run,
        generation=work.generation,
        batch=work.batch,
        attempt=work.attempt,
        wid=WID,
        n=work.n,
        joints=shape.joints,
        descriptors=shape.descriptors,
        columns=deflated(pack(rows, RESULT)),
        cpu_seconds=0.1,
    )


GROUPS = (100, 2000)
"""Rows in a transaction."""
RUNS = (1, 20)
"""Runs whose rows arrive in turns."""
SLICE = 100
"""Rows in a message."""
MESSAGES = 41
"""Messages of each run until everything is committed: two full groups."""


def measure_recording(seconds: float) -> list[Figure]:
    with ExitStack() as stack:
        journals = [SingleJournal(_folder(stack), group) for group in GROUPS]
        interleaved = [InterleavedRuns(stack, runs) for runs in RUNS]
        for writer in journals:
            stack.callback(writer.close)
        workloads = [TimedWork(f"recorder, {work.group} rows at a time", work, "wall") for work in journals]
        workloads += [
            TimedWork(f"recorder, runs in turns: {len(work.names)}", work, "wall") for work in interleaved
        ]
        return measure_in_turns(workloads, seconds / 2)


def _folder(stack: ExitStack) -> Path:
    return Path(stack.enter_context(tempfile.TemporaryDirectory(dir=Path.cwd())))


class SingleJournal:
    """A journal, a transaction at a time."""

    remark = "wall time; a transaction each, synced to the disk of this folder"
    stages: Mapping[str, float] = {}

    def __init__(self, folder: Path, group: int) -> None:
        self.group = group
        self._rows = _rows(group)
        self._done = 0
        self._writer = JournalWriter.create(folder, JournalIdentity("run", "", "", SHAPE))
        self._writer.begin_epoch(1, time.time())

    def close(self) -> None:
        self._writer.close()

    def __call__(self, meter: Meter) -> float:
        with meter.running():
            self._writer.append(JournalSlice(self._done, self._rows), 1, time.time())
        self._done += self.group
        return self.group


class InterleavedRuns:
    """Runs whose rows arrive in turns, committed in groups."""

    remark = f"wall time; {SLICE} rows in a message, committed in groups"
    stages: Mapping[str, float] = {}

    def __init__(self, stack: ExitStack, runs: int) -> None:
        self.names = [f"run-{number}" for number in range(runs)]
        self._recorder = stack.enter_context(
            open_recorder(_folder(stack) / "job", "job", 60.0, time.monotonic())
        )
        self._recorder.open(_open_message(self.names))
        self._message = slice_to_message(JournalSlice(0, _rows(SLICE)), "", self._recorder.epoch, SHAPE)
        self._done = 0

    def __call__(self, meter: Meter) -> float:
        """Take so many messages that most groups are complete, and commit what is left."""
        with meter.running():
            for _ in range(MESSAGES):
                for name in self.names:
                    self._recorder.add_rows(
                        replace(self._message, run=name, first=self._done), time.monotonic()
                    )
                    _commit(self._recorder, time.monotonic())
                self._done += SLICE
            _commit(self._recorder, inf)
        return MESSAGES * SLICE * len(self.names)


def _open_message(names: list[str]) -> Open:
    spec = to_toml(RunSpec(gripper="panda", object="mug")).encode()
    widths = {"genes": SHAPE.genes, "joints": SHAPE.joints, "descriptors": SHAPE.descriptors}
    return Open(job="job", runs=[OpenRun(run=name, spec=spec, scene="0" * 64, **widths) for name in names])


def _commit(recorder: Recorder, now: float) -> None:
    for run in recorder.due(now):
        recorder.commit(run)


def _rows(n: int) -> Rows:
    random = np.random.default_rng(0)
    rows = SHAPE.empty(n)
    rows["outcome"] = random.choice([Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD], n, p=[0.6, 0.25, 0.15])
    rows["descriptor"] = random.uniform(-0.2, 0.2, (n, 3))
    return rows
