import msgspec
import numpy as np
import trimesh
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.scene import Scene
from qdgrasp_tools.rendering.views import broad_azimuth


def scene_of(shape: trimesh.Trimesh) -> Scene:
    scene = made_scene()
    mesh = {
        "mesh_vertices": shape.vertices.astype("<f4").tobytes(),
        "mesh_faces": shape.faces.astype("<u4").tobytes(),
    }
    return msgspec.structs.replace(scene, object=msgspec.structs.replace(scene.object, **mesh))


def test_a_plate_is_seen_from_its_broad_side() -> None:
    plate = trimesh.creation.box((0.02, 0.2, 0.1))
    side = broad_azimuth(scene_of(plate))
    assert abs(np.cos(side)) > 0.9
