"""Physics engines: a table of their worlds, each imported when a scene names its engine."""

from importlib import import_module
from typing import NamedTuple

from qdgrasp_assets.scene import RestingPose, Scene
from qdgrasp_protocol.errors import AssetError, UnknownName
from qdgrasp_protocol.spec import DEVICE_ENGINE, check_engine, engine_names
from qdgrasp_worker.evaluation_protocols import EvaluationProtocol
from qdgrasp_worker.physical_episode import PhysicalWorld
from qdgrasp_worker.world import ShakenWorld


class Engine(NamedTuple):
    """The worlds of a physics engine."""

    module: str
    """The module of its worlds."""
    shaken_world: str | None
    """Class of the world of protocols that shake the hand; None: it has none."""
    physical_world: str
    """Class of the world of `physical` and `lift`, and of trials of `physical`."""


MUJOCO_WORLDS = "qdgrasp_worker.engines.mujoco_world"
ENGINES = {
    "bullet": Engine("qdgrasp_worker.engines.bullet_world", "BulletShakenWorld", "BulletPhysicalWorld"),
    "mujoco": Engine(MUJOCO_WORLDS, "MujocoShakenWorld", "MujocoPhysicalWorld"),
    DEVICE_ENGINE: Engine(MUJOCO_WORLDS, None, "MujocoPhysicalWorld"),
}
"""The device's engine has MuJoCo's own worlds; `engines.warp_worlds` simulates many of them together."""


def make_world(scene: Scene, protocol: EvaluationProtocol, name: str = "") -> ShakenWorld | PhysicalWorld:
    """A world of an engine for episodes of a protocol.

    The engine is the one of that name, or the first one of the scene. MissingEngine if it is not installed;
    AssetError if it cannot load the scene.
    """
    name = name or engine_names(scene.engine)[0]
    check_engine(name)
    if name not in ENGINES:
        raise UnknownName("engine", name, ENGINES)
    engine = ENGINES[name]
    if protocol.physics:
        table = lifting_table(scene) if protocol.lift else None
        physical: PhysicalWorld = _named(engine, engine.physical_world)(scene, protocol.physics, table)
        return physical
    if engine.shaken_world is None:
        raise AssetError(f"The engine {name} does not simulate the protocol '{protocol.name}'.")
    shaken: ShakenWorld = _named(engine, engine.shaken_world)(scene)
    return shaken


def lifting_table(scene: Scene) -> RestingPose:
    """The resting pose from which a scene's object is lifted; AssetError without one."""
    if len(scene.resting_poses) != 1:
        raise AssetError(
            f"The protocol '{scene.protocol}' needs a scene with one resting pose of its object."
        )
    return scene.resting_poses[0]


def _named(engine: Engine, world: str) -> type:
    found: type = getattr(import_module(engine.module), world)
    return found
