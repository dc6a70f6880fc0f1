"""A thousand worker sessions: how soon they have joined, how well they are served, and what they cost."""

from collections.abc import Iterator

from tests.benchmarks.scale.dispatching import Prepared, spec
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.rig import JOB, Watch, assignment, coordinate, resident, router
from tests.benchmarks.scale.stand_ins import Crowd, crowds

from qdgrasp_coordinator.bench.course import Unkept

SESSIONS = 1000
PROCESSES = 2
SECONDS = 1.0
"""What a batch takes a stand-in."""
BATCH = 16
RUNS = 4
"""A generation of one run holds 4096 genomes at most: too few for so many sessions."""
IN_FLIGHT = 4


def measure(seconds: float) -> Iterator[Figure]:
    population = SESSIONS * BATCH // RUNS
    asked = spec("contact_rand", population)
    runs = [assignment(f"run-{run}", asked, Prepared(population), IN_FLIGHT) for run in range(RUNS)]
    with router() as (endpoint, pid):
        parts = [Crowd(endpoint, JOB, SESSIONS // PROCESSES, seconds=SECONDS) for _ in range(PROCESSES)]
        with crowds(parts) as crew:
            watch = Watch(crew, runs, 2 * SECONDS, max(seconds, 5 * SECONDS))
            memory: list[tuple[int, int]] = []
            watch.at_join = watch.at_end = lambda: memory.append((resident(), resident(pid)))
            memory.append((resident(), resident(pid)))
            coordinate(endpoint, runs, lambda _: lambda run: Unkept(run.shape), watch, BATCH)
    found, (before, *_, after) = watch.window, memory
    share = min(100.0, 100 * found.batches * SECONDS / found.seconds / SESSIONS)  # what was late comes too
    own, its = ((late - early) / SESSIONS / 1024 for early, late in zip(before, after, strict=True))
    yield Figure("until 1000 sessions have joined", watch.join_seconds, "s", most=10.0)
    core = found.cpu_seconds / found.seconds
    remark = f"batches of {SECONDS:g} s; the coordinator takes {core:.0%} of a core"
    yield Figure("served, of the ideal rate", share, "%", 97.0, remark=remark)
    yield Figure("CPU of a batch", found.per_batch, "us", remark=f"{SESSIONS} workers, {BATCH} genomes")
    yield Figure("memory of the coordinator for a worker", own, "KiB")
    yield Figure("memory of the router for a worker", its, "KiB")
