"""The coordinator's whole CPU time for a genome, with the search that asks it, and no recorder."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from tests.benchmarks.scale.dispatching import BATCH, WARM_UP, WORKERS, spec
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.prepared import SHAPE
from tests.benchmarks.scale.rig import JOB, Watch, assignment, coordinate, router
from tests.benchmarks.scale.stand_ins import Crowd, crowds
from tests.coordinator.searches.spaces import plain

from qdgrasp_coordinator.bench.course import Unkept
from qdgrasp_coordinator.searches.search import Search, method
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows

METHODS = {"contact_me_scs": (500, 4.0), "cma_mae": (540, 30.0), "contact_rand": (500, None)}
"""Genomes in a generation, and the most that one may cost [us]."""


class Share:
    """CPU time of this thread within calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def of(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """The call, on this account."""

        def timed(*arguments: Any, **named: Any) -> Any:
            began = time.thread_time()
            try:
                return call(*arguments, **named)
            finally:
                self.seconds += time.thread_time() - began

        return timed


class Watched:
    """A search whose time is counted, and pyribs' own in it."""

    def __init__(self, search: Search) -> None:
        self.whole, self.ribs, self.rows = Share(), Share(), 0
        for part, names in _parts_of_ribs(search):
            for name in names:
                setattr(part, name, self.ribs.of(getattr(part, name)))
        self._ask, self._tell = self.whole.of(search.ask), self.whole.of(search.tell)

    def ask(self, generation: int) -> Genomes:
        return self._ask(generation)  # type: ignore[no-any-return]

    def tell(self, generation: int, rows: Rows) -> None:
        self.rows += len(rows)
        self._tell(generation, rows)

    @property
    def remark(self) -> str:
        whole, ribs = (1e6 * share.seconds / self.rows for share in (self.whole, self.ribs))
        return f"ask and tell {whole:.2f} us, of which pyribs {ribs:.2f} us"


def _parts_of_ribs(search: Any) -> list[tuple[Any, tuple[str, ...]]]:
    """What of pyribs a search has, and which calls it makes."""
    if hasattr(search, "_emitters"):
        return [(search._archive, ("add",)), *((emitter, ("ask", "tell")) for emitter in search._emitters)]
    return [(search.archive._grid, ("add", "data", "retrieve"))] if hasattr(search, "archive") else []


def measure(seconds: float) -> Iterator[Figure]:
    for name, (population, most) in METHODS.items():
        asked = spec(name, population)
        search = Watched(method(name).build(asked, plain(SHAPE.genes)))
        runs = [assignment("run", asked, search)]
        with router() as (endpoint, _), crowds([Crowd(endpoint, JOB, WORKERS)]) as crew:
            watch = Watch(crew, runs, WARM_UP, seconds)
            coordinate(endpoint, runs, lambda _: lambda run: Unkept(run.shape), watch, BATCH)
        cells = runs[0].pipeline.tally.cells
        remark = f"population {population}, {cells:,} cells with a success at the end; {search.remark}"
        yield Figure(f"CPU of a genome, {name}", watch.window.microseconds, "us", most=most, remark=remark)
