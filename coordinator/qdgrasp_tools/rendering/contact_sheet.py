"""Draws hands around an object, one after the other, by one camera at one scale."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Rows
from qdgrasp_tools.rendering.ray_renderer import (
    RAYS_PER_PIXEL,
    LayeredImage,
    ParallelCamera,
    RayMesh,
    fit_camera,
)
from qdgrasp_tools.rendering.views import (
    CLAY,
    ELEVATION,
    FINGER_HUES,
    DrawnLink,
    SurfaceDistanceGrid,
    best_azimuth,
    object_mesh,
    paint_link,
    paint_solid,
    rgb,
)

HAND_HUE = FINGER_HUES[0]


@dataclass(frozen=True)
class PlacedHands:
    """Hands around an object: n poses with their joints, in the object's centre-of-mass frame."""

    scene: Scene
    rows: Rows
    """(n,): the evaluations that they are of."""
    poses: Floats
    """(n, 7): x y z [m] and quaternion xyzw of the hand's root link."""
    joints: Floats
    """(n, j): finger joints [rad or m], in the gripper's order."""

    def links(self) -> Iterator[list[DrawnLink]]:
        """Yield the links of each hand where they stand."""
        hand = hand_geometry(self.scene.gripper)
        for pose, joints in zip(self.poses, self.joints, strict=True):
            yield [
                DrawnLink(Mesh(vertices, shape.faces), rgb(HAND_HUE), hand.is_finger(shape))
                for shape, vertices in hand.place_meshes(pose, joints)
            ]


def common_camera(
    hands: PlacedHands, width: int, height: int, view: tuple[float, float] | None = None
) -> ParallelCamera:
    """Return a camera with the object and every hand in its image of `width` by `height` pixels.

    `view` is azimuth and elevation about the object's z [deg]; None: where most of the object is seen.
    """
    azimuth, elevation = np.radians(view) if view else (best_azimuth(hands.scene, hands.rows), ELEVATION)
    bodies = [object_mesh(hands.scene).vertices]
    bodies += [link.mesh.vertices for links in hands.links() for link in links]
    rows, columns = RAYS_PER_PIXEL * height, RAYS_PER_PIXEL * width
    return fit_camera(np.concatenate(bodies), float(azimuth), float(elevation), rows, columns)


def paint_hands(
    hands: PlacedHands, camera: ParallelCamera, distance: SurfaceDistanceGrid
) -> Iterator[LayeredImage]:
    """Yield the image of the object with each hand alone; the next one takes its place.

    `distance` are distances from the object's surface.
    """
    image = LayeredImage(camera)
    paint_solid(image, RayMesh(object_mesh(hands.scene)), rgb(CLAY))
    for links in hands.links():
        image.translucent.clear()
        for link in links:
            paint_link(image, link, distance)
        yield image
