"""Portraits of what runs are made of: a hand open and closed, an object and its convex parts."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.mesh import Mesh, join
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_assets.solidity import Edges
from qdgrasp_assets.target import Target
from qdgrasp_coordinator.analysis.hand import Hand, hand
from qdgrasp_coordinator.analysis.layers import FINE, Image
from qdgrasp_coordinator.analysis.lettering import lettered
from qdgrasp_coordinator.analysis.picture import FAINT, INK
from qdgrasp_coordinator.analysis.rays import FIELD, Camera, Floats, Solid, camera
from qdgrasp_coordinator.analysis.signature import SIGNATURE
from qdgrasp_coordinator.analysis.views import CLAY, ELEVATION, HUES, paint_solid, rgb

SIZE, DPI = (12.0, 6.4), 100  # inches
PIXELS = 560
"""Width and height of each of the two views."""
AZIMUTH = np.radians(35.0)
BEYOND = 1.2
"""The name of an axis stands so far out, in its lengths."""
FRAME = 0.04
"""Length of the axes of a frame [m]."""
AXES = {"x": "#cc3311", "y": "#2e8b57", "z": "#2a73b9"}
OUTLINE = withStroke(linewidth=3, foreground="white")
"""Keeps a letter readable on any part."""
CLOSE = 0.01
"""What an object is drawn in is at least so wide [m]."""
OPEN = "#d62728"
STANDOFF = "#aa3377"

Piece = tuple[Mesh, Floats]
"""A mesh and its colour (3,)."""
Point = NDArray[np.floating]


def draw_gripper(gripper: SceneGripper, path: Path) -> None:
    """Draw a hand open and closed to a PNG file, its approach axis upward: fingers coloured, palm in clay.

    Axes stand in the base frame; the arrow goes from the palm as far as the stand-off's range reaches. The
    bar across it is as long as the jaw of a two-finger hand opens, along its axis.
    """
    drawn, upright = hand(gripper), _upright(gripper)
    postures = {
        "open": [joint.opened for joint in gripper.joints],
        "closed": [joint.closed for joint in gripper.joints],
    }
    panels = {name: _links(drawn, upright, joints) for name, joints in postures.items()}
    words = (
        f"frame: base link {gripper.base_link}; arrow: from the palm, {gripper.palm_offset:g} m along the "
        "approach axis"
    )
    words += ", to the greatest stand-off" + ("; bar: the jaw" if gripper.jaw else "")
    directions = upright.as_matrix()
    palm, near, far = (
        upright.apply(np.array(gripper.approach_axis) * (gripper.palm_offset + reach))
        for reach in (0.0, *gripper.standoff)
    )
    figure, seen, views = _two_views(gripper.name, words, panels, tips=np.array([*FRAME * directions.T, far]))
    for axes in views:
        _frame(axes, seen, directions)
        _arrow(axes, seen, palm, far, STANDOFF)
        axes.plot(*seen_at(seen, near), "o", color=STANDOFF, markersize=5)
        if gripper.jaw is not None:
            half = upright.apply(np.array(gripper.jaw.axis) * gripper.jaw.opening / 2)
            ends = [seen_at(seen, far + side * half) for side in (-1, 1)]
            axes.plot(*zip(*ends, strict=True), "|-", color=STANDOFF, markersize=8, linewidth=1.6)
    figure.savefig(path, format="png", metadata=SIGNATURE)


def draw_object(target: Target, path: Path) -> None:
    """Draw an object's surface and its convex parts to a PNG file, in its centre-of-mass frame."""
    parts = [(part, rgb(HUES[turn % len(HUES)])) for turn, part in enumerate(target.centred_parts)]
    panels = {"surface": [(target.centred_mesh, rgb(CLAY))], f"convex parts: {len(parts)}": parts}
    words = f"{_size(target.mesh)}, centre of mass where the axes meet, parts: {target.collision_source}"
    figure, seen, views = _two_views(target.name, words, panels, CLOSE, np.eye(3) * _reach(target.mesh))
    for axes in views:
        _frame(axes, seen, np.eye(3), _reach(target.mesh))
    figure.savefig(path, format="png", metadata=SIGNATURE)


def draw_mesh(name: str, mesh: Mesh, path: Path) -> None:
    """Draw a mesh from two sides to a PNG file, around its middle; open edges are red, those behind too."""
    loose, middle = mesh.vertices[Edges(mesh).loose], np.mean(mesh.bounds, axis=0)
    turn = Rotation.from_euler("z", 180, degrees=True).as_matrix()
    sides = {"one side": np.eye(3), "the other side": turn}
    centred = {title: Mesh((mesh.vertices - middle) @ side.T, mesh.faces) for title, side in sides.items()}
    panels = {title: [(seen_so, rgb(CLAY))] for title, seen_so in centred.items()}
    words = f"{_size(mesh)}, axes of the mesh file around its middle, edges with one triangle: {len(loose)}"
    figure, seen, views = _two_views(
        name, words, panels, CLOSE, np.concatenate(list(sides.values())) * _reach(mesh)
    )
    for axes, side in zip(views, sides.values(), strict=True):
        _frame(axes, seen, side, _reach(mesh))
        lines = [[seen_at(seen, end) for end in edge] for edge in (loose - middle) @ side.T]
        axes.add_collection(LineCollection(lines, colors=OPEN, linewidths=1.6))
    figure.savefig(path, format="png", metadata=SIGNATURE)


def seen_at(seen: Camera, point: Point) -> tuple[float, float]:
    """The column and row of the finished image where a point (3,) is."""
    right, up = (seen.seen(point[None])[0, :2] - seen.low) / (seen.step * FINE)
    return float(right), float(seen.rows / FINE - up)


def _upright(gripper: SceneGripper) -> Rotation:
    """The least turn that brings the approach axis upward."""
    return Rotation.align_vectors([[0, 0, 1]], [gripper.approach_axis])[0]


def _links(drawn: Hand, upright: Rotation, joints: Sequence[float]) -> list[Piece]:
    pose = np.concatenate([np.zeros(3), upright.as_quat()])
    return [
        (Mesh(vertices, shape.faces), rgb(HUES[0] if drawn.is_finger(shape) else CLAY))
        for shape, vertices in drawn.posed(pose, np.array(joints))
    ]


def _size(mesh: Mesh) -> str:
    return " x ".join(f"{side:.4g}" for side in mesh.extents) + " m"


def _reach(mesh: Mesh) -> float:
    """How long the axes of a frame within a mesh are drawn [m]."""
    return 0.6 * float(mesh.extents.max())


def _two_views(
    name: str,
    words: str,
    panels: dict[str, list[Piece]],
    field: float = FIELD,
    tips: Point = np.zeros((1, 3)),  # noqa: B008  # nobody writes into it
) -> tuple[Figure, Camera, list[Axes]]:
    """A figure with a titled view of each panel's pieces, all from one camera, at least `field` [m] wide.

    The points `tips` (n, 3) [m] are in the image, with some room around them.
    """
    meshes = [mesh for pieces in panels.values() for mesh, _ in pieces]
    points = np.concatenate([np.zeros((1, 3)), BEYOND * tips, *(mesh.vertices for mesh in meshes)])
    seen = camera(points, AZIMUTH, ELEVATION, FINE * PIXELS, FINE * PIXELS, field)
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    figure.text(0.022, 0.945, lettered(name), size=20, weight="bold", color=INK, va="center")
    figure.text(0.022, 0.89, lettered(words), size=11, color=FAINT, va="center")
    views = [figure.add_axes((0.02 + 0.49 * turn, 0.02, 0.47, 0.8)) for turn in range(len(panels))]
    for axes, (title, pieces) in zip(views, panels.items(), strict=True):
        axes.imshow(_painted(pieces, seen), interpolation="none")
        axes.set_title(title, size=12, color=INK, loc="left")
        axes.set_axis_off()
    return figure, seen, views


def _painted(pieces: list[Piece], seen: Camera) -> Floats:
    image = Image(seen)
    colours = np.concatenate([np.tile(colour, (len(mesh.faces), 1)) for mesh, colour in pieces])
    paint_solid(image, Solid(join([mesh for mesh, _ in pieces])), colours)
    return image.finished()


def _frame(axes: Axes, seen: Camera, directions: Point, length: float = FRAME) -> None:
    """The axes of a frame at the origin; `directions` are the columns of a matrix (3, 3)."""
    for (name, colour), direction in zip(AXES.items(), directions.T, strict=True):
        _arrow(axes, seen, np.zeros(3), length * direction, colour)
        there = seen_at(seen, BEYOND * length * direction)
        axes.text(*there, name, color=colour, ha="center", va="center", path_effects=[OUTLINE])


def _arrow(axes: Axes, seen: Camera, start: Point, end: Point, colour: str) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", seen_at(seen, end), seen_at(seen, start), arrowprops=style)
