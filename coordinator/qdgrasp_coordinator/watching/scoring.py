"""Scoring given poses on this machine: the same coordinator, bus and workers as a run, without a recorder."""

import tempfile
from contextlib import ExitStack
from pathlib import Path

from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.campaigns.programme import Single
from qdgrasp_coordinator.counts.poses import Poses
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.runs.preparation import scene_shape
from qdgrasp_coordinator.searches.given import Given
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_coordinator.watching.watch import Watch
from qdgrasp_coordinator.watching.workers import GRACE, hire_worker
from qdgrasp_protocol.crew import Crew
from qdgrasp_protocol.genome import GIVEN
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_protocol.trials import trials
from qdgrasp_protocol.zenoh_bus import ZenohBus

JOB = "evaluate"
GENERATION = 4096
"""Poses that are handed out before the first result is waited for."""


def score(
    spec: RunSpec, scene: Scene, bundle: Bundle, poses: Poses, team: Team, display: Display, stop: Stop
) -> Rows:
    """Evaluate poses with a scene's gripper and object; rows as in a journal: in the order of the poses."""
    shape = scene_shape(scene, GIVEN)
    search = Given(poses.genomes(scene), GENERATION)
    pipeline = Pipeline(search, shape, evaluations=len(poses), overlaps="count", trials=trials(spec.protocol))
    assignment = Assignment(RUN, to_toml(spec).encode(), bundle, GIVEN, shape, pipeline, len(poses))
    memory = Memory(shape)
    with ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
        bus, endpoint = ZenohBus.embedded(None)
        stack.enter_context(bus)
        crew = stack.enter_context(Crew(logs, GRACE))
        for number in range(max(1, team.workers)):
            hire_worker(crew, number, ["--connect", endpoint, "--job", JOB])
        watch = Watch(crew, display)
        service = CoordinatorService(
            bus,
            stop,
            job=JOB,
            programme=Single(lambda: assignment, len(poses)),
            make_record=lambda _: memory,
            batch_size=team.batch_size,
        )

        def look(now: float) -> None:
            figures = service.figures(now)
            watch.progressed(figures)
            watch.look(now)
            display.show(figures)

        service.run(look)
    return memory.rows
