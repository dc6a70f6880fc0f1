"""What a genome costs the coordinator, the bus apart: ask, lease, encode, decode, settle, tell, hand on."""

import numpy as np
from tests.benchmarks.ledger import Ledger
from tests.benchmarks.measure import Figure, Meter, Subject, in_turns
from tests.coordinator.searches import make_believe
from tests.coordinator.searches.spaces import plain

from qdgrasp_coordinator.counts.stretch import to_message
from qdgrasp_coordinator.dispatching.dispatch import Dispatch
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.searches.search import AIMED, Search, method
from qdgrasp_protocol import codec
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.messages import Result, Work
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Rows, Shape, pack, unpack
from qdgrasp_protocol.spec import RunSpec

SHAPE = Shape(genes=7, joints=2)
WID = "0" * 32
METHODS = ("contact_rand", "contact_me_scs", "cma_mae", "aimed")
BATCH = 64


def measure(seconds: float) -> list[Figure]:
    return in_turns([Subject(f"coordinator, {name}", Coordinator(name)) for name in METHODS], seconds)


class Watched:
    """A search in a ledger."""

    def __init__(self, search: Search, ledger: Ledger) -> None:
        self._search = search
        self._ledger = ledger

    def ask(self, generation: int) -> Genomes:
        with self._ledger.within("ask"):
            return self._search.ask(generation)

    def tell(self, generation: int, rows: Rows) -> None:
        with self._ledger.within("tell"):
            self._search.tell(generation, rows)


class Coordinator:
    """A coordinator's work on a run whose worker answers at once."""

    def __init__(self, name: str) -> None:
        chosen = method(name)
        space = make_believe.space("aimed") if chosen is AIMED else plain(SHAPE.genes)
        spec = RunSpec(
            gripper="panda", object="mug", method=name, evaluations=10**9, population=chosen.population
        )
        self._prior = chosen.prior
        self._shape = make_believe.shape(space) if chosen is AIMED else SHAPE
        self._ledger = Ledger()
        with self._ledger.within("ask"):
            search = Watched(chosen.build(spec, space), self._ledger)
            self._pipeline = Pipeline(search, self._shape, spec.evaluations, "count")
        self._ledger.seconds.clear()
        self._layout = space.layout
        self._scale = 1.0 if chosen is AIMED else 0.2  # m, of what the first three genes stand for
        self._dispatch = Dispatch(1, BATCH)
        self._dispatch.join(WID, 1, 8, [], 0.0)

    def __call__(self, meter: Meter) -> float:
        """Have the next batches evaluated; how many rows became final."""
        before = self._pipeline.tally.rows
        with meter.running():
            sent = self._lease()
        for payload in sent:
            answer = self._worker(codec.decode(payload, Work))
            with meter.running():
                self._settle(answer)
        return self._pipeline.tally.rows - before

    def _lease(self) -> list[bytes]:
        with self._ledger.within("pipeline"):
            asked = self._pipeline.ask()
        with self._ledger.within("dispatch"):
            if asked is not None:
                self._dispatch.submit(
                    "run", "0" * 64, self._prior, asked.number, asked.indices, asked.trials, asked.genomes
                )
            leases = self._dispatch.leases(0.0)
        with self._ledger.within("messages"):
            return [codec.encode(lease.work(1)) for lease in leases]

    def _settle(self, answer: bytes) -> None:
        with self._ledger.within("messages"):
            result = codec.decode(answer, Result)
            rows = unpack(self._shape.empty(result.n), RESULT, result.columns, self._shape)
        with self._ledger.within("dispatch"):
            settled = self._dispatch.settle(WID, result, rows, 0.0)
        if settled.rows is None:
            return
        with self._ledger.within("pipeline"):
            final = self._pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures)
        with self._ledger.within("messages"):
            codec.encode(to_message(final, "run", 1, self._shape))

    @property
    def stages(self) -> dict[str, float]:
        """Microseconds of a genome by what they are spent on."""
        rows = self._pipeline.tally.rows
        return {name: 1e6 * seconds / rows for name, seconds in self._ledger.seconds.items()}

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
        return codec.encode(_result(work, self._shape, rows))


def _result(work: Work, shape: Shape, rows: Rows) -> Result:
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
        columns=pack(rows, RESULT),
        cpu_seconds=0.1,
    )
