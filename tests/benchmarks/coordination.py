"""What a genome costs the coordinator, the bus apart: ask, lease, encode, decode, settle, tell, hand on."""

import numpy as np
from tests.benchmarks.measure import Figure, Meter
from tests.coordinator import make_believe
from tests.coordinator.spaces import plain

from qdgrasp_coordinator.dispatch import Dispatch
from qdgrasp_coordinator.pipeline import Pipeline
from qdgrasp_coordinator.search import AIMED, method
from qdgrasp_coordinator.stretch import to_message
from qdgrasp_protocol import codec
from qdgrasp_protocol.messages import Result, Work
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Shape, pack, unpack
from qdgrasp_protocol.spec import RunSpec

SHAPE = Shape(genes=7, joints=2)
WID = "0" * 32
METHODS = ("contact_rand", "contact_me_scs", "aimed")


def measure(seconds: float) -> list[Figure]:
    return [_coordinator(name, seconds) for name in METHODS]


def _coordinator(name: str, seconds: float) -> Figure:
    chosen = method(name)
    space = make_believe.space("aimed") if chosen is AIMED else plain(SHAPE.genes)
    shape = make_believe.shape(space) if chosen is AIMED else SHAPE
    spec = RunSpec(
        gripper="panda", object="mug", method=name, evaluations=10**9, population=chosen.population
    )
    pipeline = Pipeline(chosen.build(spec, space), shape, spec.evaluations, "count")
    dispatch = Dispatch(1, 64)
    dispatch.join(WID, 1, 8, [], 0.0)
    meter = Meter()
    while meter.seconds < seconds / 2:
        with meter.running():
            if (asked := pipeline.ask()) is not None:
                dispatch.submit(
                    "run", "0" * 64, chosen.prior, asked.number, asked.indices, asked.trials, asked.genomes
                )
            sent = [codec.encode(lease.work(1)) for lease in dispatch.leases(0.0)]
        for payload in sent:
            answer = _worker(codec.decode(payload, Work), shape)
            with meter.running():
                result = codec.decode(answer, Result)
                rows = unpack(shape.empty(result.n), RESULT, result.columns, shape)
                settled = dispatch.settle(WID, result, rows, 0.0)
                if settled.rows is not None:
                    final = pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures)
                    codec.encode(to_message(final, "run", 1, shape))
    rows_done = pipeline.tally.rows
    remark = f"genomes, in batches of 64; {pipeline.tally.cells:,} cells at the end"
    return Figure(f"coordinator, {name}", rows_done, meter.seconds, "cpu", remark)


def _worker(work: Work, shape: Shape) -> bytes:
    """A result at once: positions and outcomes follow from the genomes."""
    genomes = np.frombuffer(work.columns["genome"], "<f4").reshape(work.n, work.genes)
    rows = shape.empty(work.n)
    rows["descriptor"][:, :3] = 0.2 * genomes[:, :3]
    rows["base_to_object"][:, 6] = 1.0
    rows["outcome"] = np.where(genomes[:, 3] > 0.6, Outcome.HELD, Outcome.OVERLAP)
    rows["fitness"] = np.maximum(rows["outcome"].astype(int) - Outcome.DROPPED, 0)
    result = Result(
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
    return codec.encode(result)
