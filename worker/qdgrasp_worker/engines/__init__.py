"""Physics engines: a table of their worlds, each imported when a scene names its engine."""

from dataclasses import replace
from importlib import import_module

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import DEFAULT_ENGINE, DEVICE_ENGINE, check_engine, engine_names
from qdgrasp_worker.contact_margin import slim_scene
from qdgrasp_worker.evaluation_protocols import COARSE, EvaluationProtocol
from qdgrasp_worker.physical_episode import PhysicalWorld
from qdgrasp_worker.world import ShakenWorld

ENGINES = {
    DEFAULT_ENGINE: ("qdgrasp_worker.engines.bullet_world", "Bullet", {}),
    "mujoco": ("qdgrasp_worker.engines.mujoco_world", "Mujoco", COARSE),
    "mujoco-fine": ("qdgrasp_worker.engines.mujoco_world", "Mujoco", {}),
    DEVICE_ENGINE: ("qdgrasp_worker.engines.mujoco_world", "Mujoco", COARSE),
}
"""The module of each engine's worlds, how the names of their classes begin, and its settings of `physical`.

The device's engine has MuJoCo's own worlds; `engines.warp_worlds` simulates many of them together.
"""


def make_world(scene: Scene, protocol: EvaluationProtocol, name: str = "") -> ShakenWorld | PhysicalWorld:
    """A world of an engine for episodes of a protocol.

    The engine is the one of that name, or the first one of the scene. MissingEngine if it is not installed;
    AssetError if it cannot load the scene.
    """
    name = name or engine_names(scene.engine)[0]
    check_engine(name)
    where, prefix, settings = ENGINES[name]
    module = import_module(where)
    scene = slim_scene(scene)
    if protocol.physics:
        table = scene.resting_poses[0] if protocol.lift else None
        physics = replace(protocol.physics, **settings)
        physical: PhysicalWorld = getattr(module, f"{prefix}PhysicalWorld")(scene, physics, table)
        return physical
    if name == DEVICE_ENGINE:
        raise AssetError(f"The engine {name} does not simulate the protocol '{protocol.name}'.")
    shaken: ShakenWorld = getattr(module, f"{prefix}ShakenWorld")(scene)
    return shaken
