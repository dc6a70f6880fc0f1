"""Playing histories: from a number to a verdict."""

import logging
import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

import structlog
from tests.simulation.coordinator import Coordinator
from tests.simulation.faults import Faults
from tests.simulation.plan import History, draw
from tests.simulation.searching import Violated
from tests.simulation.stage import Stage
from tests.simulation.watch import Watch

from qdgrasp_coordinator.dispatching import tickets
from qdgrasp_coordinator.recording import intake
from qdgrasp_coordinator.serving import outbox, recorder_link

SMALL = [(outbox, "SLICE", 4), (outbox, "BOUND", 8), (recorder_link, "PAGE", 7), (tickets, "REMEMBERED", 30)]
SMALL += [(intake, "GROUP_ROWS", 6), (intake, "CAPACITY", 150)]
"""Bounds that small histories reach."""


@dataclass
class Verdict:
    """How a history went."""

    history: History
    violated: Violated | None = None
    seconds: float = 0.0
    """How long it took in its world."""
    events: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    """What the last coordinator's dispatch counted."""
    journals: dict[str, bytes] = field(default_factory=dict)
    """What is on the disk of each run."""
    trace: list[str] = field(default_factory=list)


@contextmanager
def small_and_quiet() -> Iterator[None]:
    """Bounds that small histories reach, and no logs."""
    quiet = structlog.make_filtering_bound_logger(logging.CRITICAL)
    before = structlog.get_config()
    structlog.configure(wrapper_class=quiet, cache_logger_on_first_use=False)
    patches = [patch.object(module, name, value) for module, name, value in SMALL]
    try:
        for one in patches:
            one.start()
        yield
    finally:
        for one in patches:
            one.stop()
        structlog.configure(**before)


def play(history: History | int, *, trace: bool = False) -> Verdict:
    """Play a history to its end, or to the first violation."""
    if isinstance(history, int):
        history = draw(history)
    with small_and_quiet():
        return _play(history, trace)


def _play(history: History, trace: bool) -> Verdict:
    random.seed(history.number)  # the jitter of workers
    stage = Stage(history)
    watch = Watch(stage)
    world = stage.world
    world.look = watch.look
    world.trace = [] if trace else None
    verdict = Verdict(history)
    try:
        stage.open()
        Faults(stage).plan()
        world.run(lambda: stage.is_over)
    except Violated as violated:
        verdict.violated = violated
    except Exception as error:  # noqa: BLE001 - whatever it is, a machine failed
        verdict.violated = Violated("no machine fails", f"{type(error).__name__}: {error}")
        verdict.violated.__cause__ = error
    verdict.seconds, verdict.events, verdict.trace = world.now, world.events, world.trace or []
    coordinators = stage.of(Coordinator, living=False)
    verdict.counters = coordinators[-1].turn.dispatch.counters if coordinators else {}
    verdict.journals = {run: paper.journal for run, paper in stage.disk.papers.items()}
    return verdict
