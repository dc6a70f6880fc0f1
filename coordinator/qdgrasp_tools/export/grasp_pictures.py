"""Cards of grasps for notebooks, and scenes of trimesh."""

import io
from base64 import b64encode
from collections.abc import Iterable
from html import escape

import numpy as np
import trimesh
from PIL import Image

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Rows
from qdgrasp_tools.export.frames import COM, Frame
from qdgrasp_tools.rendering import views

CARD_PIXELS, CARD_COLOURS = 320, 128  # Width, height and colours of a picture: it stays below 100 kB
FINGER_COLOUR = views.FINGER_HUES[0]


def grasp_card(scene: Scene, rows: Rows, title: str, figures: Iterable[tuple[str, str]]) -> str:
    """Return HTML for a notebook: a picture of a row's hand as it settled, and its figures."""
    view = views.view_of_hands(scene, rows, views.best_azimuth(scene, rows), CARD_PIXELS)
    image, file = Image.fromarray(np.rint(255 * view.image).astype(np.uint8)), io.BytesIO()
    image.quantize(CARD_COLOURS, dither=Image.Dither.NONE).save(file, format="PNG", optimize=True)
    source = f"data:image/png;base64,{b64encode(file.getvalue()).decode()}"
    lines = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in figures)
    return (
        f'<div style="display:flex;gap:16px"><img src="{source}" alt="{escape(title)}">'
        f"<div><b>{escape(title)}</b><table>{lines}</table></div></div>"
    )


def grasp_scene(scene: Scene, pose: Floats, joints: Floats, frame: Frame) -> trimesh.Scene:
    """Return object and hand, its root link at a pose (7,) in a frame of the object [m].

    The nodes are `object`, and those of `hand_scene`.
    """
    made = hand_scene(scene.gripper, pose, joints)
    middle = np.eye(4)
    if frame != COM:
        middle[:3, 3] = scene.object.com_in_mesh
    body = _coloured(views.object_mesh(scene), views.CLAY)
    made.add_geometry(body, node_name="object", geom_name="object", transform=middle)
    made.metadata["frame"] = frame
    return made


def hand_scene(gripper: SceneGripper, pose: Floats, joints: Floats) -> trimesh.Scene:
    """Return a hand whose root link stands at a pose (7,), with these joints (j,) [m, rad].

    The nodes are `hand`, the frame of the root link, and below it `hand/LINK`, the collision shapes of each
    link that has any, which are what is simulated.
    """
    hand = hand_geometry(gripper)
    frames = hand.link_frames(pose, joints)
    root, made = frames[gripper.base_link], trimesh.Scene()
    made.graph.update(frame_to="hand", matrix=root)  # type: ignore[no-untyped-call]  # of trimesh
    for name, mesh in hand.link_meshes.items():
        colour = FINGER_COLOUR if name in gripper.finger_links else views.STEEL
        made.add_geometry(
            _coloured(mesh, colour),
            node_name=f"hand/{name}",
            geom_name=f"hand/{name}",
            parent_node_name="hand",
            transform=np.linalg.inv(root) @ frames[name],
        )
    return made


def _coloured(mesh: Mesh, colour: str) -> trimesh.Trimesh:
    """Return a mesh of trimesh in metres, with every face in a colour."""
    paint = np.rint(255 * np.append(views.rgb(colour), 1.0)).astype(np.uint8)
    paints = np.tile(paint, (len(mesh.faces), 1))
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, face_colors=paints, process=False)
    made.units = "meters"
    return made
