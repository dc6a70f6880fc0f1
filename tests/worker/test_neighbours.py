"""Neighbours: fixed bodies around an object that hands cannot come near, and do not grasp."""

from contextlib import closing

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.genomes import evaluated, outcomes
from tests.worker.test_physical_episode import ABOVE, SIDE, physical
from tests.worker.test_pose_filters import ABOVE_IT, UNDER

from qdgrasp_assets.geometry.mesh import Mesh, box, parts_to_obj
from qdgrasp_assets.scene import Scene, pack_scene, unpack_scene
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.episode import EpisodeResult
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, TrialSetup
from qdgrasp_worker.evaluator import make_episode

HALF = 0.0285  # Half a side of the cube [m]


@pytest.fixture(scope="module", params=[None, "mujoco"], ids=["bullet", "mujoco"])
def engine(request) -> str | None:
    return request.param


def beside(scene: Scene, *bodies: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Scene:
    """A scene with boxes of some sides and centres [m], in a frame with axes along the cube's sides."""
    turn = Rotation.from_rotvec([0.0, 0.0, SIDE])
    placed = [box(sides).moved(centre) for sides, centre in bodies]
    parts = [Mesh(turn.apply(mesh.vertices), mesh.faces) for mesh in placed]
    return msgspec.structs.replace(scene, neighbours=parts_to_obj(parts))


def walls(gap: float, height: float) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Four walls of 6 mm around the cube, from its lower side on."""
    place, middle = HALF + gap + 0.003, height / 2 - HALF
    along = [((0.006, 0.05, height), (sign * place, 0.0, middle)) for sign in (-1, 1)]
    return along + [((0.05, 0.006, height), (0.0, sign * place, middle)) for sign in (-1, 1)]


TABLE = ((0.6, 0.6, 0.04), (0.0, 0.0, -HALF - 0.02))


def simulated(scene: Scene) -> EpisodeResult:
    """The result of the hand above the cube, which no filter looks at."""
    protocol = PROTOCOLS[scene.protocol]
    with closing(make_world(scene, protocol)) as world:
        return make_episode(world, protocol).run(TrialSetup(ABOVE))


@pytest.mark.parametrize("protocol", ["physical", "lift"])
def test_a_cube_on_a_box_is_grasped_from_above_and_not_from_below(engine, protocol):
    scene = beside(physical(engine, protocol=protocol), TABLE)
    genomes = np.concatenate([ABOVE_IT, UNDER])
    assert outcomes(evaluated(scene, GIVEN, genomes)) == [Outcome.HELD, Outcome.OVERLAP]


def test_fingers_that_are_stopped_by_walls_do_not_touch_the_cube_between_them(engine):
    low, high = walls(gap=0.002, height=0.01), walls(gap=0.002, height=0.05)
    assert simulated(beside(physical(engine), *low)).outcome is Outcome.HELD
    stopped = simulated(beside(physical(engine), *high))
    assert stopped._replace(steps=0) == EpisodeResult(Outcome.MISSED, ABOVE.joints)


def test_a_cage_makes_no_grasp_of_what_slips(engine):
    bare = physical(engine, friction=0.005)
    lid = ((0.02, 0.02, 0.01), (0.0, 0.0, HALF + 0.006))
    caged = simulated(beside(bare, *walls(gap=0.0005, height=0.015), TABLE, lid))
    assert simulated(bare).outcome < Outcome.HELD
    assert caged.outcome < Outcome.HELD
    assert caged.finger_links == 2


def test_a_bundle_holds_them_and_one_without_has_the_bytes_it_had():
    scene = physical(None)
    around = pack_scene(beside(scene, TABLE))
    assert unpack_scene(around.payload).neighbours == beside(scene, TABLE).neighbours
    assert around.digest != pack_scene(scene).digest
    assert b"neighbours" not in pack_scene(scene).payload
