"""A million rows of a search on their way to a recorder's disk, and back when a coordinator resumes."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.benchmarks.scale.dispatching import WORKERS, spec
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.prepared import SHAPE
from tests.benchmarks.scale.rig import JOB, Watch, assignment, coordinate, resident, router
from tests.benchmarks.scale.stand_ins import Crowd, crowds
from tests.coordinator.searches.spaces import plain

from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.searches.search import method
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.recorder_link import RecorderLink
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.zenoh_bus import ZenohBus

ROWS = 1_000_000
METHODS = {"contact_rand": 50_000, "contact_me_scs": None}
"""The rows in a second that are wanted."""
POPULATION, BATCH = 500, 50


def measure(seconds: float) -> Iterator[Figure]:
    for name, least in METHODS.items():
        with (
            tempfile.TemporaryDirectory(dir=Path.cwd(), prefix=".scale-") as folder,
            router() as (endpoint, _),
        ):
            out = Path(folder) / "job"
            yield from _record(name, least, endpoint, out)
            yield from _resume(name, endpoint, out)


def _record(name: str, least: float | None, endpoint: str, out: Path) -> Iterator[Figure]:
    runs = [_run(name)]
    with _recorder(endpoint, out) as recorder, crowds([Crowd(endpoint, JOB, WORKERS)]) as crew:
        watch = Watch(crew, runs, 0.0, float("inf"))
        began, cpu = time.perf_counter(), time.process_time()
        coordinate(endpoint, runs, lambda bus: lambda run: RecorderLink(bus, JOB, run.shape), watch, BATCH)
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
        memory = resident(recorder.pid)
    size = sum(path.stat().st_size for path in out.rglob("run.sqlite*"))
    remark = f"{name}, a million, each on the disk; the coordinator {1e6 * cpu / ROWS:.1f} us of CPU each"
    yield Figure("recorded rows a second", ROWS / seconds, "/s", least, remark=remark)
    yield Figure("journal of a row", size / ROWS, "bytes", remark=f"the recorder takes {memory / 1e6:.0f} MB")


def _resume(name: str, endpoint: str, out: Path) -> Iterator[Figure]:
    with _recorder(endpoint, out), ZenohBus.connect(endpoint, 10.0, Stop()) as bus:
        lane = Lane(_run(name), RecorderLink(bus, JOB, SHAPE))
        began, cpu = time.perf_counter(), time.process_time()
        lane.open(0, lambda: time.sleep(0.05))
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    assert lane.tally.rows == ROWS
    remark = f"{name}: replayed through ask and tell; {cpu:.1f} CPU s of the coordinator"
    yield Figure("resume at a million rows", seconds, "s", remark=remark)


def _run(name: str) -> Assignment:
    asked = spec(name, POPULATION, ROWS)
    return assignment("run", asked, method(name).build(asked, plain(SHAPE.genes)))


@contextmanager
def _recorder(endpoint: str, out: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The recorder as it is, in a process of its own."""
    command = [sys.executable, "-m", "qdgrasp_coordinator.cli.recorder"]
    command += ["--connect", endpoint, "--job", JOB, "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()
