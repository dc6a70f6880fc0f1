"""Dispatch alone: prepared genomes out through a real router, prepared results back, and nothing is kept."""

from collections.abc import Iterator

import numpy as np
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.prepared import SHAPE
from tests.benchmarks.scale.rig import ENDLESS, JOB, Watch, assignment, coordinate, router
from tests.benchmarks.scale.stand_ins import Crowd, crowds

from qdgrasp_coordinator.bench.course import Unkept
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec

WORKERS = 8
BATCH = 64
POPULATION = 512
IN_FLIGHT = 4
WARM_UP = 1.0
"""Seconds before anything is counted."""


class Prepared:
    """A search that asks the same genomes again and again, and learns nothing."""

    def __init__(self, population: int) -> None:
        self._genomes = np.random.default_rng(0).uniform(-1, 1, (population, SHAPE.genes)).astype(np.float32)

    def ask(self, generation: int) -> Genomes:
        return self._genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Nothing is learned."""


def spec(method: str, population: int, evaluations: int = ENDLESS) -> RunSpec:
    return RunSpec(
        gripper="panda", object="mug", method=method, population=population, evaluations=evaluations
    )


def measure(seconds: float) -> Iterator[Figure]:
    runs = [assignment("run", spec("contact_rand", POPULATION), Prepared(POPULATION), IN_FLIGHT)]
    with router() as (endpoint, _), crowds([Crowd(endpoint, JOB, WORKERS)]) as crew:
        watch = Watch(crew, runs, WARM_UP, seconds)
        coordinate(endpoint, runs, lambda _: lambda run: Unkept(run.shape), watch, BATCH)
    found = watch.window
    remark = f"{found.per_batch:.0f} us of CPU a batch, threads of the bus included"
    yield Figure("batches of 64 genomes a second", found.batches / found.seconds, "/s", 5_000, remark=remark)
    yield Figure("genomes a second", found.rows / found.seconds, "/s", 300_000)
    yield Figure("CPU of a genome", found.microseconds, "us")
    room = 1e6 / found.microseconds
    yield Figure("genomes in a CPU second", room, "/s", remark="what the coordinator's own core allows")
