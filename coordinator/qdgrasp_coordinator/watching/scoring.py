"""Scoring given poses on this machine: the same coordinator, bus and workers as a run, without a recorder."""

from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.campaigns.programme import Single
from qdgrasp_coordinator.counts.poses import Poses
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.runs.preparation import scene_shape
from qdgrasp_coordinator.searches.given import Given
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_coordinator.watching.errand import run_errand
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.genome import GIVEN
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_protocol.trials import trials

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
    run_errand(JOB, Single(lambda: assignment, len(poses)), lambda _: memory, team, display, stop)
    return memory.rows
