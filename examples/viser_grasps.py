"""Grasps of a run in the browser with viser (`pip install viser`): `python viser_grasps.py runs/mug`.

A port may follow the folder; the page is at http://127.0.0.1:8080 until Ctrl-C.
"""

import sys

import viser

import qdgrasp

grasps = qdgrasp.open(sys.argv[1]).grasps(diverse=20)
server = viser.ViserServer("127.0.0.1", int(sys.argv[2]) if len(sys.argv) > 2 else 8080)
server.scene.set_up_direction("+z")
server.initial_camera.position = (0.3, -0.5, 0.35)  # [m]
server.scene.add_frame("/mesh_file", axes_length=0.05, axes_radius=0.001)
labels = [f"{grasp.number}: {grasp.outcome.name.lower()}" for grasp in grasps]
chosen = server.gui.add_dropdown("Grasp", labels)
closed = server.gui.add_checkbox("Closed", True)
shown = []


@chosen.on_update
@closed.on_update
def show(_event=None):
    """Draw the object and the hand of the chosen grasp, each link a mesh of trimesh."""
    while shown:
        shown.pop().remove()
    scene = grasps[labels.index(chosen.value)].scene("mesh", closed=closed.value)
    for name in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph.get(name)
        mesh = scene.geometry[geometry].copy().apply_transform(matrix)
        shown.append(server.scene.add_mesh_trimesh(f"/{name}", mesh))


show()
server.sleep_forever()
