"""Draws PNG files of hands, objects and meshes from two sides; axes and bars of views."""

from itertools import cycle
from pathlib import Path
from typing import BinaryIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.mesh import Mesh, join
from qdgrasp_assets.geometry.mesh_repair import MeshEdges
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.object_model import ObjectModel
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_tools.rendering.ray_renderer import (
    FIELD,
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
    PaintedMesh,
    RenderedView,
    paint_solid,
    rgb,
)

PNG_SIGNATURE = {"Software": "qdgrasp"}  # By which the CLI knows files that were drawn here
INK = "#22262b"
AXIS_COLOURS = {"x": "#cc3311", "y": "#2e8b57", "z": "#2a73b9"}
FRAME_LENGTH = 0.04  # Length of the axes of a frame [m]


def figure_text(words: str) -> str:
    """Escape dollars, which begin mathematics in figures."""
    return words.replace("$", r"\$")


FAINT = "#69717a"
SCALE_BAR = 0.05  # Length of the scale bar [m]


def show_view(axes: Axes, view: RenderedView, interpolation: str = "none") -> None:
    """Show a view with a bar of 5 cm in the lower right corner."""
    axes.imshow(view.image, interpolation=interpolation)
    axes.set_axis_off()
    rows, columns, _ = view.image.shape
    length = SCALE_BAR / (view.camera.step * RAYS_PER_PIXEL)
    right, low = 0.985 * columns, 0.985 * rows
    axes.plot([right - length, right], [low, low], color=FAINT, linewidth=2, solid_capstyle="butt")
    axes.text(
        right - length / 2, low - 0.012 * rows, "5 cm", size=11, color=FAINT, ha="center", va="bottom",
        path_effects=[OUTLINE],
    )  # fmt: skip


def axes_triad(axes: Axes, view: RenderedView, length: float = 0.05) -> None:
    """Draw the object's axes in the lower left corner, `length` long (share of the height)."""
    rows, columns, _ = view.image.shape
    x, y, length = 1.5 * length * columns, (1 - 1.4 * length) * rows, length * rows
    for name, (right, up, _) in zip("xyz", view.camera.axes.T.tolist(), strict=True):
        end = (x + length * right, y - length * up)
        axes.annotate("", end, (x, y), arrowprops={"arrowstyle": "-|>", "color": FAINT, "linewidth": 1.4})
        beyond = (x + 1.32 * length * right, y - 1.32 * length * up)
        axes.text(*beyond, name, size=11, color=FAINT, ha="center", va="center")


PORTRAIT_SIZE, PORTRAIT_DPI = (12.0, 6.4), 100  # inches
PORTRAIT_PIXELS = 560  # Width and height of each of the two views
AZIMUTH = np.radians(35.0)
BEYOND = 1.2  # The name of an axis stands so far out, in its lengths
OUTLINE = withStroke(linewidth=3, foreground="white")  # Keeps a letter readable on any part
CLOSE_TOGETHER = 0.01  # Least width of the view of an object [m]
OPEN_EDGE_COLOUR = "#d62728"
STANDOFF_COLOUR = "#aa3377"

Point3 = NDArray[np.floating]


def draw_gripper(gripper: SceneGripper, path: Path | BinaryIO) -> None:
    """Draw a hand open and closed, its approach axis upward: a PNG, to a path or an open file.

    Fingers are coloured, the palm is clay. Axes stand in the base frame; the arrow goes from the palm as far
    as the stand-off's range reaches. The bar across it is as long as the jaw of a two-finger hand opens,
    along its axis.
    """
    hand = hand_geometry(gripper)
    upright = Rotation.align_vectors([[0, 0, 1]], [gripper.approach_axis])[0]  # the least rotation
    postures = {
        "open": [joint.opened for joint in gripper.joints],
        "closed": [joint.closed for joint in gripper.joints],
    }
    root = np.concatenate([np.zeros(3), upright.as_quat()])
    panels = {
        name: [
            (Mesh(vertices, shape.faces), rgb(FINGER_HUES[0] if shape.link in gripper.finger_links else CLAY))
            for shape, vertices in hand.place_meshes(root, np.array(joints))
        ]
        for name, joints in postures.items()
    }
    words = (
        f"frame: base link {gripper.base_link}; arrow: from the palm, {gripper.palm_offset:g} m along the "
        f"approach axis, to the greatest stand-off{'; bar: the jaw' if gripper.jaw else ''}"
    )
    directions = upright.as_matrix()
    palm, near, far = (
        upright.apply(np.array(gripper.approach_axis) * (gripper.palm_offset + reach))
        for reach in (0.0, *gripper.standoff)
    )
    figure, camera, views = _two_views(
        gripper.name, words, panels, tips=np.array([*FRAME_LENGTH * directions.T, far])
    )
    for axes in views:
        _draw_frame(axes, camera, directions)
        _draw_arrow(axes, camera, palm, far, STANDOFF_COLOUR)
        axes.plot(*project_point(camera, near), "o", color=STANDOFF_COLOUR, markersize=5)
        if gripper.jaw is not None:
            half = upright.apply(np.array(gripper.jaw.axis) * gripper.jaw.opening / 2)
            ends = [project_point(camera, far + side * half) for side in (-1, 1)]
            axes.plot(*zip(*ends, strict=True), "|-", color=STANDOFF_COLOUR, markersize=8, linewidth=1.6)
    figure.savefig(path, format="png", metadata=PNG_SIGNATURE)


def draw_object(target: ObjectModel, path: Path) -> None:
    """Draw an object's surface and its convex parts, CoM frame, to a PNG file."""
    hues = cycle(map(rgb, FINGER_HUES))
    parts = list(zip(target.centred_parts, hues, strict=False))
    panels = {"surface": [(target.centred_mesh, rgb(CLAY))], f"convex parts: {len(parts)}": parts}
    words = (
        f"{_size_words(target.mesh)}, centre of mass where the axes meet, parts: {target.collision_source}"
    )
    reach = _reach(target.mesh)
    figure, camera, views = _two_views(target.name, words, panels, CLOSE_TOGETHER, reach * np.eye(3))
    for axes in views:
        _draw_frame(axes, camera, np.eye(3), reach)
    figure.savefig(path, format="png", metadata=PNG_SIGNATURE)


def draw_mesh(name: str, mesh: Mesh, path: Path) -> None:
    """Draw a mesh from two sides, around its middle, to a PNG file.

    Open edges are red, also those behind.
    """
    loose, middle = mesh.vertices[MeshEdges(mesh).open_edges], np.mean(mesh.bounds, axis=0)
    sides = {"one side": np.eye(3), "the other side": Rotation.from_euler("z", 180, degrees=True).as_matrix()}
    centred = {title: Mesh((mesh.vertices - middle) @ side.T, mesh.faces) for title, side in sides.items()}
    panels = {title: [(seen_so, rgb(CLAY))] for title, seen_so in centred.items()}
    words = (
        f"{_size_words(mesh)}, axes of the mesh file around its middle, edges with one triangle: {len(loose)}"
    )
    reach = _reach(mesh)
    tips = reach * np.concatenate(list(sides.values()))
    figure, camera, views = _two_views(name, words, panels, CLOSE_TOGETHER, tips)
    for axes, side in zip(views, sides.values(), strict=True):
        _draw_frame(axes, camera, side, reach)
        lines = [[project_point(camera, end) for end in edge] for edge in (loose - middle) @ side.T]
        axes.add_collection(LineCollection(lines, colors=OPEN_EDGE_COLOUR, linewidths=1.6))
    figure.savefig(path, format="png", metadata=PNG_SIGNATURE)


def project_point(camera: ParallelCamera, point: Point3) -> tuple[float, float]:
    """Return the column and row of the finished image at which a point (3,) lies."""
    right, up = (camera.project(point[None])[0, :2] - camera.low) / (camera.step * RAYS_PER_PIXEL)
    return float(right), float(camera.rows / RAYS_PER_PIXEL - up)


def _size_words(mesh: Mesh) -> str:
    return " x ".join(f"{side:.4g}" for side in mesh.extents) + " m"


def _reach(mesh: Mesh) -> float:
    """Return the length of the axes of a frame within a mesh [m]."""
    return 0.6 * float(mesh.extents.max())


def _two_views(
    name: str,
    words: str,
    panels: dict[str, list[PaintedMesh]],
    field: float = FIELD,
    tips: Point3 = np.zeros((1, 3)),  # noqa: B008  # it is only read
) -> tuple[Figure, ParallelCamera, list[Axes]]:
    """Make a figure with a titled view of each panel's pieces, all from one camera.

    The image is at least `field` [m] wide; the points `tips` (n, 3) [m] are in it, with some room.
    """
    meshes = [mesh for pieces in panels.values() for mesh, _ in pieces]
    points = np.concatenate([np.zeros((1, 3)), BEYOND * tips, *(mesh.vertices for mesh in meshes)])
    camera = fit_camera(points, AZIMUTH, ELEVATION, (PORTRAIT_PIXELS, PORTRAIT_PIXELS), field)
    figure = Figure(figsize=PORTRAIT_SIZE, dpi=PORTRAIT_DPI, facecolor="white")
    figure.text(0.022, 0.945, figure_text(name), size=20, weight="bold", color=INK, va="center")
    figure.text(0.022, 0.89, figure_text(words), size=11, color=FAINT, va="center")
    views = [figure.add_axes((0.02 + 0.49 * n, 0.02, 0.47, 0.8)) for n in range(len(panels))]
    for axes, (title, pieces) in zip(views, panels.items(), strict=True):
        image = LayeredImage(camera)
        colours = np.concatenate([np.tile(colour, (len(mesh.faces), 1)) for mesh, colour in pieces])
        paint_solid(image, RayMesh(join([mesh for mesh, _ in pieces])), colours)
        axes.imshow(image.composed(), interpolation="none")
        axes.set_title(title, size=12, color=INK, loc="left")
        axes.set_axis_off()
    return figure, camera, views


def _draw_frame(axes: Axes, camera: ParallelCamera, directions: Point3, length: float = FRAME_LENGTH) -> None:
    """Draw axes at the origin; `directions` are the columns of a matrix (3, 3)."""
    for (name, colour), direction in zip(AXIS_COLOURS.items(), directions.T, strict=True):
        _draw_arrow(axes, camera, np.zeros(3), length * direction, colour)
        there = project_point(camera, BEYOND * length * direction)
        axes.text(*there, name, color=colour, ha="center", va="center", path_effects=[OUTLINE])


def _draw_arrow(axes: Axes, camera: ParallelCamera, start: Point3, end: Point3, colour: str) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", project_point(camera, end), project_point(camera, start), arrowprops=style)
