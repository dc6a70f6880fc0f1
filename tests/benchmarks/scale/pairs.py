"""Two real workers against one, in turns: each pair is measured side by side, as `qdgrasp bench` does it."""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from tests.benchmarks.measure import spread
from tests.benchmarks.scale.figures import Figure

from qdgrasp_coordinator.bench.course import Course
from qdgrasp_coordinator.bench.regimes import METHOD
from qdgrasp_coordinator.runs.preparation import full_spec, make_bundle
from qdgrasp_coordinator.watching.progress import PlainLines
from qdgrasp_protocol.crew import Crew
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.zenoh_bus import ZenohBus

PAIRS = 5
WORKERS = 2
LEAST = 1.8


def measure(seconds: float) -> Iterator[Figure]:
    pairs = [_pair(seconds) for _ in range(PAIRS)]
    for regime in pairs[0]:
        found = [pair[regime] for pair in pairs]
        remark = f"{PAIRS} pairs: {spread(found)}; Panda on the mug"
        yield Figure(f"two workers over one, {regime}", median(found), "times", LEAST, remark=remark)


def _pair(seconds: float) -> dict[str, float]:
    """One worker, then two: how many times as fast they are, by regime."""
    spec = full_spec({"gripper": "panda", "object": "mug", "method": METHOD}, "scale")
    scene, bundle = make_bundle(spec)
    course = Course(spec, scene, bundle, workers=WORKERS, seconds=seconds, display=PlainLines("scale"))
    with ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
        bus, endpoint = ZenohBus.embedded(None)
        stack.enter_context(bus)
        found = course.run(bus, endpoint, stack.enter_context(Crew(logs)), Stop())
    assert found is not None
    return found.figures.scaling
