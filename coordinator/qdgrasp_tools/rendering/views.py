"""Renders hands on an object, or the cells around it; chooses the side to show."""

import io
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import cycle

import numpy as np
import trimesh
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.spatial import ConvexHull, KDTree
from trimesh.remesh import subdivide

from qdgrasp_assets.geometry.mesh import Mesh, join, parse_parts
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.regions import allowed_points
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.metrics import success_metrics
from qdgrasp_coordinator.metrics.cells import PER_METRE, cell_keys, cells
from qdgrasp_coordinator.metrics.grasp_quality import settled_poses
from qdgrasp_coordinator.metrics.successes import survival
from qdgrasp_protocol.rows import Rows
from qdgrasp_tools.rendering.ray_renderer import (
    Floats,
    LayeredImage,
    ParallelCamera,
    RayMesh,
    fit_camera,
    shadowed_light,
    soft_light,
)

AZIMUTHS = np.radians(np.arange(-165, 180, 30))  # Azimuths that are tried


def broad_azimuth(scene: Scene) -> float:
    """Return the azimuth [rad] that shows most of the object: the one with the largest outline."""
    vertices = scene.object.mesh.vertices
    views = [fit_camera(vertices, azimuth, ELEVATION, (100, 100)) for azimuth in AZIMUTHS]
    outlines = [ConvexHull(view.project(vertices)[:, :2]).volume for view in views]
    return float(AZIMUTHS[int(np.argmax(outlines))])


ELEVATION = np.radians(26.0)
CLAY, STEEL = "#f7e6ca", "#a8b3bf"  # Colours of the object, and of links whose touch makes no success
ALLOWED, FORBIDDEN = "#a0dd7c", "#ecc9b4"  # Colours of an object with regions: where contacts may be, or not
NEIGHBOUR = "#7d8894"  # Colour of the fixed bodies around it
LONGEST_EDGE = 0.003  # Of triangles on the border of what may be touched [m]
FINGER_HUES = (
    "#4477aa", "#ee7733", "#009988", "#cc3311", "#33bbee", "#aa3377", "#c0a020", "#332288", "#6a8f2f",
)  # fmt: skip
"""Colours of hands in turn: neighbours are told apart with any colour vision."""
CUBE = trimesh.creation.box((0.0072,) * 3)  # Stands for a cell; smaller than that, so that cubes stay apart
CUT_OPEN_CELLS = 600
"""With more cells, those toward the viewer's right are left out to show the inside."""


PaintedMesh = tuple[Mesh, Floats]  # A mesh and its colour (3,)
Poses = NDArray[np.float64]


@dataclass(frozen=True)
class RenderedView:
    """An image with its camera and the successes in it."""

    image: Floats
    """(pixels, pixels, 3) in [0, 1]."""
    camera: ParallelCamera
    """With `RAYS_PER_PIXEL` rays for each pixel, along each side."""
    shown: Rows
    is_uncut: bool = True
    """True: nothing was left out to show the inside."""


def hand_picture(scene: Scene, row: Rows, size: tuple[int, int], view: tuple[float, float]) -> bytes:
    """Render the object with one hand, `row` (1,), as it settled, on a clear ground: a PNG.

    `size` is width and height [pixels], `view` azimuth and elevation about the object's z [deg].
    """
    azimuth, elevation = np.radians(view)
    image = _image_of_hands(scene, row, azimuth, elevation, size)
    light, dark = image.composed(), image.composed(ground=0.0)
    covered = 1 - (light - dark).mean(axis=2, keepdims=True)
    layers = np.concatenate([dark / np.maximum(covered, 1e-3), covered], axis=2)
    file = io.BytesIO()
    Image.fromarray(np.rint(255 * np.clip(layers, 0, 1)).astype(np.uint8)).save(file, format="PNG")
    return file.getvalue()


def view_of_hands(scene: Scene, rows: Rows, azimuth: float, pixels: int) -> RenderedView:
    """Render the object with the hands of `rows` (n,) on it, as they settled."""
    image = _image_of_hands(scene, rows, azimuth, ELEVATION, (pixels, pixels))
    return RenderedView(image.composed(), image.camera, rows)


def _image_of_hands(
    scene: Scene, rows: Rows, azimuth: float, elevation: float, size: tuple[int, int]
) -> LayeredImage:
    (body, margins), hand = object_surface(scene), hand_geometry(scene.gripper)
    links = [
        (Mesh(vertices, shape.faces), hue, shape.link in hand.gripper.finger_links)
        for hue, pose, posture in zip(
            cycle(map(rgb, FINGER_HUES)), settled_poses(rows), rows["joints"], strict=False
        )
        for shape, vertices in hand.place_meshes(pose, posture.astype(float))
    ]
    points = np.concatenate([body.vertices, *(mesh.vertices for mesh, *_ in links)])
    image = LayeredImage(fit_camera(points, azimuth, elevation, size))
    paint_solid(image, RayMesh(body), object_colour(scene), margins)
    paint_neighbours(image, scene)
    for mesh, hue, is_finger in links:
        hits = RayMesh(mesh).cast_from(image.camera)  # fingers nearly solid, the palm like glass
        edge = (1 - np.abs(hits.normals @ image.camera.axes[2])) ** 2
        shaded = hue * (0.5 + 0.55 * soft_light(hits.normals, image.camera)[:, None])
        paler, opacity = (0.2, 0.85 + 0.1 * edge) if is_finger else (0.35, 0.08 + 0.34 * edge)
        image.add_translucent(hits, np.clip(shaded + (1 - shaded) * paler, 0, 1), opacity)
    return image


def view_of_cells(
    scene: Scene,
    best: Rows,
    azimuth: float,
    pixels: int,
    beside: Sequence[NDArray[np.integer]] = (),
) -> RenderedView:
    """Render the object, and a cube for the cell of each of the rows `best` (n,).

    The rows are in distinct cells. The cubes have the colours of their fitness. Cells `beside` it (m, 3), of
    other views of the object, are in the image's bounds, and it is cut open where one of these views is.
    """
    places = cells(best["descriptor"][:, :3])
    (body, margins), views = object_surface(scene), [places, *beside]
    points = np.concatenate([body.vertices, *(_cubes(each).vertices for each in views)])
    image = LayeredImage(fit_camera(points, azimuth, ELEVATION, (pixels, pixels)))
    hues = np.array([rgb(colour) for colour in success_metrics.FITNESS_COLOURS])[survival(best)]
    right, _, toward = image.camera.project(places / PER_METRE).T
    kept = (right < 0) | (toward < 0) | (max(map(len, views)) <= CUT_OPEN_CELLS)
    cubes = np.repeat(hues[kept], len(CUBE.faces), axis=0)
    colours = np.concatenate([np.tile(object_colour(scene), (len(body.faces), 1)), cubes])
    solid = RayMesh(join([body, _cubes(places[kept])]))
    paint_solid(
        image, solid, colours, np.append(margins, np.zeros(len(CUBE.vertices) * kept.sum(), np.float32))
    )
    paint_neighbours(image, scene)
    return RenderedView(image.composed(), image.camera, best, bool(kept.all()))


def best_in_cells(successes: Rows) -> Rows:
    """Return the fittest success in each cell, of equals the first."""
    ordered = successes[np.argsort(-successes["fitness"], kind="stable")]
    _, first = np.unique(cell_keys(cells(ordered["descriptor"][:, :3])), return_index=True)
    return ordered[first]


def paint_solid(
    image: LayeredImage,
    solid: RayMesh,
    colour: Floats,
    margins: Floats | None = None,
    *,
    has_shadows: bool = True,
) -> None:
    """Paint a solid in one colour (3,) or one for each face (f, 3), maybe with its own shadows.

    Where `margins` (v,), as of `object_surface`, are below 0 it is `FORBIDDEN`.
    """
    hits = solid.cast_from(image.camera)
    light = 0.35 + 0.75 * soft_light(hits.normals, image.camera)
    if has_shadows:
        light = 0.14 + 0.92 * shadowed_light(hits, solid, image.camera) ** 0.7
    colours = np.array(colour[hits.faces] if colour.ndim > 1 else np.broadcast_to(colour, hits.points.shape))
    if margins is not None:
        colours[(hits.weights * margins[hits.corners]).sum(axis=1) < 0] = rgb(FORBIDDEN)
    image.add_solid(hits, np.clip(colours * light[:, None], 0, 1).astype(np.float32))


def object_colour(scene: Scene) -> Floats:
    """Return the colour of an object, with regions that of the part that contacts may be on."""
    return rgb(ALLOWED if scene.regions else CLAY)


def object_surface(scene: Scene) -> tuple[Mesh, Floats]:
    """Return an object's mesh, and how far the corners (v,) are inside what may be touched [m].

    Below 0 they are outside; all are 0 without regions. Triangles on a border are split into small ones.
    """
    vertices, faces = scene.object.mesh.vertices, scene.object.mesh.faces
    if not scene.regions:
        return scene.object.mesh, np.zeros(len(vertices), np.float32)
    samples, allowed = allowed_points(scene)
    trees = KDTree(samples[allowed]), KDTree(samples[~allowed])
    while True:
        inside, outside = (tree.query(vertices)[0] for tree in trees)
        margins = np.clip(outside - inside, -1, 1).astype(np.float32)  # infinite if there is no outside
        corners = vertices[faces]
        lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        crossed = (lengths > LONGEST_EDGE) & (np.abs(margins[faces]).max(axis=1) < lengths)
        if not crossed.any():
            return Mesh(vertices, faces), margins
        vertices, faces = subdivide(vertices, faces, crossed)  # type: ignore[no-untyped-call]  # of trimesh


def paint_neighbours(image: LayeredImage, scene: Scene) -> None:
    """Paint the fixed bodies around an object like glass."""
    for part in parse_parts(scene.neighbours.decode()):
        hits = RayMesh(part).cast_from(image.camera)
        edge = (1 - np.abs(hits.normals @ image.camera.axes[2])) ** 2
        light = 0.5 + 0.5 * soft_light(hits.normals, image.camera)[:, None]
        image.add_translucent(hits, rgb(NEIGHBOUR) * light, 0.18 + 0.3 * edge)


def _cubes(places: NDArray[np.integer]) -> Mesh:
    """Return a cube around the middle of each cell (n, 3)."""
    vertices = (places[:, None] / PER_METRE + CUBE.vertices).reshape(-1, 3)
    return Mesh(vertices, (8 * np.arange(len(places))[:, None, None] + CUBE.faces).reshape(-1, 3))


def rgb(colour: str) -> Floats:
    """Return red, green and blue of a colour (3,), in [0, 1]."""
    return np.array(to_rgb(colour), dtype=np.float32)


CARD_PIXELS = 320  # Width and height of a picture in a notebook
FINGER_COLOUR = FINGER_HUES[0]


def grasp_card(scene: Scene, row: Rows, title: str, figures: Iterable[tuple[str, str]]) -> str:
    """Return HTML for a notebook: a picture of the hand of `row` (1,), and its figures."""
    view = np.degrees(broad_azimuth(scene)), np.degrees(ELEVATION)
    picture = hand_picture(scene, row, (CARD_PIXELS, CARD_PIXELS), view)
    source = f"data:image/png;base64,{b64encode(picture).decode()}"
    lines = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in figures)
    return (
        f'<div style="display:flex;gap:16px"><img src="{source}" alt="{escape(title)}">'
        f"<div><b>{escape(title)}</b><table>{lines}</table></div></div>"
    )


def grasp_scene(scene: Scene, pose: Poses, joints: Poses, com: ArrayLike) -> trimesh.Scene:
    """Return object and hand, its root link at a pose (7,) [m, xyzw], as a scene of trimesh.

    `com` (3,) [m] is the object's centre of mass. The nodes are `object`, and those of `hand_scene`.
    """
    made = hand_scene(scene.gripper, pose, joints)
    middle = np.eye(4)
    middle[:3, 3] = com
    body = _coloured(scene.object.mesh, CLAY)
    made.add_geometry(body, node_name="object", geom_name="object", transform=middle)
    return made


def hand_scene(gripper: SceneGripper, pose: Poses, joints: Poses) -> trimesh.Scene:
    """Return a hand whose root link stands at a pose (7,), with these joints (j,) [m, rad].

    The nodes are `hand`, the frame of the root link, and below it `hand/LINK`, the collision shapes of each
    link that has any, which are what is simulated.
    """
    hand = hand_geometry(gripper)
    frames = hand.link_frames(pose, joints)
    root, made = frames[gripper.base_link], trimesh.Scene()
    made.graph.update(frame_to="hand", matrix=root)  # type: ignore[no-untyped-call]  # of trimesh
    for name, mesh in hand.link_meshes.items():
        colour = FINGER_COLOUR if name in gripper.finger_links else STEEL
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
    paint = np.rint(255 * np.append(rgb(colour), 1.0)).astype(np.uint8)
    paints = np.tile(paint, (len(mesh.faces), 1))
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, face_colors=paints, process=False)
    made.units = "meters"
    return made
