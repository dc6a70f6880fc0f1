"""Episodes of `lift` in each engine: objects lifted off a table, and independent episodes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.genomes import evaluated, outcomes, results
from tests.worker.test_physical_episode import ABOVE, physical
from tests.worker.test_pose_filters import ABOVE_IT, UNDER

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_protocol.spec import run_spec
from qdgrasp_worker.evaluation_protocols import LIFT

ENGINES = [None, "mujoco"]


def lifting(engine: str | None, **more: str | float) -> Scene:
    return physical(engine, **{"protocol": "lift", "resting_pose": 0, **more})


@pytest.fixture(scope="module", params=ENGINES, ids=["bullet", "mujoco"])
def scene(request) -> Scene:
    return lifting(request.param)


def hands_above(n: int, seed: int) -> np.ndarray:
    """Genomes of the prior given (n, 7): hands that come from above, somewhere over the cube, in any roll."""
    random = np.random.default_rng(seed)
    rolls = Rotation.from_rotvec(random.uniform(-0.6, 0.6, (n, 1)) * [(0.0, 0.0, 1.0)])
    leans = Rotation.from_rotvec(random.normal(0.0, 0.15, (n, 3)))
    turns = leans * rolls * Rotation.from_quat(ABOVE.quaternion)
    positions = leans.apply(ABOVE.position) + random.normal(0.0, 0.008, (n, 3))
    return np.hstack([positions, turns.as_quat()]).astype(np.float32)


def outcome(scene: Scene, genome: np.ndarray = ABOVE_IT) -> Outcome:
    return outcomes(evaluated(scene, GIVEN, genome))[0]


def test_a_cube_is_lifted_from_above_and_no_hand_comes_from_below(scene):
    rows = evaluated(scene, GIVEN, np.concatenate([ABOVE_IT, UNDER]))
    assert outcomes(rows) == [Outcome.HELD, Outcome.OVERLAP]
    assert rows["fitness"].tolist() == [1.0, 0.0]
    assert rows["contacts"][0] == 2


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_too_heavy_or_too_slippery_stays_on_the_table(engine):
    grip, weight = 2 * 35.0 * 0.5, 9.81 + LIFT.lift.acceleration
    assert outcome(lifting(engine, mass=0.8 * grip / weight)) is Outcome.HELD
    assert outcome(lifting(engine, mass=1.3 * grip / weight)) is Outcome.DROPPED
    assert outcome(lifting(engine, friction=0.004)) <= Outcome.DROPPED


def test_lifting_ends_early_only_where_it_would_end_so_anyway(scene, monkeypatch):
    scene, genomes = lifting(scene.engine, mass=1.8), hands_above(40, seed=4)
    rows = evaluated(scene, GIVEN, genomes)
    monkeypatch.setattr("qdgrasp_worker.physical_episode.LiftEpisode._ends_early", lambda *_: False)
    assert results(evaluated(scene, GIVEN, genomes), "steps") == results(rows, "steps")


def test_it_needs_one_resting_pose():
    asked = {"gripper": "panda", "object": "mug", "protocol": "lift"}
    assert run_spec(asked).table_pose == 0
    assert run_spec(asked).approach == 0.1
    assert run_spec(asked | {"resting_pose": 3}).table_pose == 3
    assert run_spec(asked).disturbances == 1
    with pytest.raises(InputError, match="lifts the object from one resting pose"):
        run_spec(asked | {"resting_pose": "any"})
    with pytest.raises(InputError, match="mujoco-warp"):
        run_spec(asked | {"engine": "mujoco-warp", "approach_distance": 0.0})
