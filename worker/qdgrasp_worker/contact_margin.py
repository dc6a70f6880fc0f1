"""The hand and the neighbours that engines get in `physical`: smaller by contact margins.

Hulls meet `HULL_MARGIN` outside of their surfaces, boxes and spheres at them. Both margins of a pair are
taken from the hand, as an object's walls may be as thin: flat surfaces meet in place, edges are rounded.
They are taken from neighbours too, which an object so meets in place, and a hand 2 mm late, as a table.
"""

import xml.etree.ElementTree as ET

import numpy as np
from msgspec.structs import replace

from qdgrasp_assets.geometry.mesh import Mesh, hull, parse_parts, parts_to_obj
from qdgrasp_assets.geometry.voxels import Hull, convex_hulls
from qdgrasp_assets.grippers import collision_shapes
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_assets.scene import Scene
from qdgrasp_worker.evaluation_protocols import scene_protocol

HULL_MARGIN = 1e-3  # Distance from a hull's surface at which both engines meet it; 0 for a box [m]
LEAST_SHARE = 0.5  # Share of its half width that a shape keeps, however thin it is


def slim_scene(scene: Scene) -> Scene:
    """The scene that its worlds get; shapes that Bullet alone takes stay as they are."""
    if scene_protocol(scene).physics is None:
        return scene
    robot, meshes = scene_robot(scene.gripper), dict(scene.gripper.meshes)
    for number, (_, collision) in enumerate(collision_shapes.collision_elements(robot)):
        for shape in collision.findall("geometry/*")[:1]:
            if shape.tag in ("box", "sphere", "cylinder"):
                for name, sizes in shape.attrib.items():
                    by = HULL_MARGIN * (1 + (shape.tag == "cylinder")) * (1 if name == "radius" else 2)
                    less = [max(float(size) - by, LEAST_SHARE * float(size)) for size in sizes.split()]
                    shape.set(name, " ".join(map(repr, less)))
            elif collision_shapes.CONCAVE not in collision.attrib:
                parts = convex_hulls(collision_shapes.geometry_corners(shape, meshes))
                meshes[f"{number}.obj"] = parts_to_obj(map(smaller, parts))
                shape.attrib |= {"filename": f"{number}.obj", "scale": "1 1 1"} if parts else {}
    urdf = ET.tostring(robot.element, encoding="unicode")
    around = convex_hulls(part.vertices for part in parse_parts(scene.neighbours.decode()))
    neighbours = parts_to_obj(map(smaller, around)) if around else b""
    return replace(scene, gripper=replace(scene.gripper, urdf=urdf, meshes=meshes), neighbours=neighbours)


def smaller(part: Hull) -> Mesh:
    """A hull with its planes moved inward by both margins, towards the greatest ball within."""
    from scipy import optimize, spatial  # slow to import

    walls = np.column_stack([part.normals, np.ones(len(part.planes))])
    ball = np.array(optimize.linprog([0, 0, 0, -1], walls, -part.planes[:, 3], bounds=(None, None)).x)
    planes = part.grown(-min(2 * HULL_MARGIN, (1 - LEAST_SHARE) * ball[3])).planes
    corners = spatial.HalfspaceIntersection(planes, ball[:3]).intersections
    return hull(np.unique(corners.round(7), axis=0))  # the last bits of a solver decide nothing
