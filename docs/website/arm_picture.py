"""Picture of an arm at a grasp of a run, between what is around the object, for docs/where.md.

python -m docs.website.arm_picture docs/where/arm.png runs/in-a-bin X Y Z R P Y

The arm is the Franka Panda of pybullet_data, its base at that pose in the frame of the mesh [m, rad].
"""

import sys
from pathlib import Path

import numpy as np
import pybullet_data
import trimesh
from PIL import Image

from qdgrasp_assets.geometry.mesh import Mesh, parse_parts
from qdgrasp_assets.geometry.rotation import from_euler
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_tools.export.arm import Arm
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run, select_grasps
from qdgrasp_tools.export.grasp_table import to_matrices
from qdgrasp_tools.rendering.ray_renderer import LayeredImage, RayMesh, fit_camera
from qdgrasp_tools.rendering.views import CLAY, NEIGHBOUR, STEEL, paint_solid, rgb

PANDA = Path(pybullet_data.getDataPath(), "franka_panda", "panda.urdf")
VIEW, SIZE = np.radians((-60.0, 20.0)), (720, 560)  # Azimuth and elevation; columns and rows


def main(out: Path, run: Path, *base: float) -> None:
    """Draw the arm at the first of the run's best grasps that it comes to."""
    grasps = select_grasps(read_run(RunFolder.open(run)), GraspChoice(top=50))
    scene, axis = grasps.scene, np.array(grasps.scene.gripper.approach_axis)
    arm = Arm(PANDA, "mesh", base, scene.gripper.base_link, None, (0.0,) * 6).among(scene)
    reached, found = arm.columns(grasps.poses(), axis, 0.1)
    sys.stdout.write(f"{reached.values.sum()} of {len(grasps)} are reached\n")
    best = int(np.argmax(reached.values))
    robot = read_urdf(PANDA)
    names = [joint.name for joint in robot.joints if joint.kind == "revolute"]
    joints = dict(zip(names, found.values[best], strict=True))
    joints |= dict(zip(grasps.joint_names, grasps.pregrasp[best].tolist(), strict=True))
    root = to_matrices(np.array([[*base[:3], *from_euler(np.array([base[3:]]))[0]]]))[0]
    links = [(mesh, rgb(STEEL)) for mesh in link_meshes(robot, robot.forward(joints, root))]
    com = scene.object.com_in_mesh
    around = [(part.moved(com), rgb(NEIGHBOUR)) for part in parse_parts(scene.neighbours.decode())]
    bodies = [*links, (scene.object.mesh.moved(com), rgb(CLAY)), *around]
    points = np.concatenate([mesh.vertices for mesh, _ in bodies])
    image = LayeredImage(fit_camera(points, *VIEW, SIZE))
    for mesh, hue in bodies:
        paint_solid(image, RayMesh(mesh), hue, has_shadows=False)
    out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(255 * image.composed()).astype(np.uint8)).save(out, optimize=True)


def link_meshes(robot, frames) -> list[Mesh]:
    """The collision shapes of an arm where its links are."""
    found = []
    for link, frame in frames.items():
        for mesh in robot.element.findall(f"link[@name='{link}']/collision/geometry/mesh"):
            path = PANDA.parent / mesh.get("filename").removeprefix("package://")
            shape = trimesh.load_mesh(path, process=False)
            found.append(Mesh(shape.vertices @ frame[:3, :3].T + frame[:3, 3], np.array(shape.faces)))
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(float, sys.argv[3:]))
