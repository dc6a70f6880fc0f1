"""Pictures of grasps with words beside them, cards for notebooks, scenes of trimesh."""

from typing import TYPE_CHECKING

import numpy as np
import trimesh

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.metrics.run_stats import outcome_words
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.frames import COM, MESH, Frame
from qdgrasp_tools.rendering import html_cards
from qdgrasp_tools.rendering.contact_sheet import (
    HAND_HUE,
    PanelLabel,
    PlacedHands,
    common_camera,
    contact_sheet,
    draw_hands,
)
from qdgrasp_tools.rendering.views import CLAY, object_mesh, rgb

if TYPE_CHECKING:
    from qdgrasp_tools.export.grasp_set import Grasps

FAILURE_COLOUR = "#d3d8dd"  # Of the dot of an evaluation that was no success


def placed_hands(grasps: "Grasps", *, pregrasp: bool = False) -> PlacedHands:
    """Return the hands as they settled, or open in the commanded pose.

    A hand that never closed, since it overlapped the object, is open in any case.
    """
    is_open = pregrasp | (grasps.rows["outcome"] < Outcome.MISSED)[:, None]
    poses = np.where(is_open, grasps.poses(COM), grasps.settled_poses(COM))
    joints = np.where(is_open, grasps.pregrasp, grasps.joints).astype(np.float64)
    return PlacedHands(grasps.scene, grasps.rows, poses, joints)


def grasp_labels(grasps: "Grasps") -> list[PanelLabel]:
    """Return the words below each grasp: number and outcome, then eta or fitness, and margin."""
    labels = []
    for place in range(len(grasps)):
        outcome, eta = Outcome(grasps.rows["outcome"][place]), grasps.eta[place]
        score = f"fitness {grasps.fitness[place]:g} of {grasps.spec.disturbances}"
        parts = [score if np.isnan(eta) else f"eta {eta:.2f}"]
        if not np.isnan(grasps.margin[place]):
            parts.append(f"margin {grasps.margin[place]:.2g}")
        colour = FITNESS_COLOURS[outcome - Outcome.DROPPED] if outcome.is_success else FAILURE_COLOUR
        title = f"{grasps.numbers[place]}  {outcome_words(outcome)}"
        labels.append(PanelLabel(title, ", ".join(parts), colour))
    return labels


CARD_PIXELS = (360, 320)  # Width and height of the picture of one grasp
PANEL_PIXELS, MOST_SHOWN = (220, 190), 6  # Size of each of several, and how many are shown


def grasps_card(grasps: "Grasps") -> str:
    """Return grasps as HTML: a picture of the first few, and how many of them ended how."""
    counts = {outcome: int((grasps.rows["outcome"] == outcome).sum()) for outcome in reversed(Outcome)}
    figures: list[html_cards.Figure] = [
        (outcome_words(outcome), number) for outcome, number in counts.items() if number
    ]
    shown = grasps[:MOST_SHOWN]
    shown = shown[np.flatnonzero(shown.rows["base_to_object"].any(axis=1))]
    if not len(shown):
        return html_cards.card(_names(grasps), None, [("grasps", len(grasps)), *figures])
    hands = placed_hands(shown)
    camera = common_camera(hands, *PANEL_PIXELS)
    title = f"the first {len(shown)} of {len(grasps)}" if len(shown) < len(grasps) else ""
    sheet = contact_sheet(draw_hands(hands, camera), grasp_labels(shown), title, camera)
    return html_cards.card(_names(grasps), sheet, [("grasps", len(grasps)), *figures])


def grasp_card(alone: "Grasps") -> str:
    """Return one grasp as HTML: the hand as it settled, and its key figures."""
    (grasp,), (margin,), ((moved, turned),) = alone, alone.margin, alone.motion
    figures: list[html_cards.Figure] = [("outcome", outcome_words(grasp.outcome))]
    figures.append(("fitness", f"{grasp.fitness:g} of {alone.spec.disturbances}"))
    if grasp.trials:
        figures.append(("eta", f"{grasp.eta:.3f} ± {grasp.eta_error:.3f}, {grasp.trials} trials"))
    if not np.isnan(margin):
        figures.append(("margin", f"{margin:.3g}"))
    figures.append(("finger links in contact", int(alone.rows["contacts"][0])))
    figures.append(("penetration", f"{1000 * alone.rows['penetration'][0]:.2f} mm"))
    if not np.isnan(moved):
        figures.append(("object moved", f"{1000 * moved:.1f} mm, {np.degrees(turned):.1f}°"))
    if grasp.synergy:
        figures.append(("synergy", grasp.synergy))
    position = ", ".join(f"{value:.4f}" for value in grasp.settled_position)
    figures.append(("settled at, in the mesh's frame", f"{position} m"))
    title, picture = f"Grasp {grasp.number} of {_names(alone)}", None
    if alone.rows["base_to_object"].any():
        hands = placed_hands(alone)
        (picture,) = draw_hands(hands, common_camera(hands, *CARD_PIXELS))
    return html_cards.card(title, picture, figures)


def _names(grasps: "Grasps") -> str:
    return f"{grasps.scene.gripper.name} on {grasps.scene.object.name}"


PALM_COLOUR = "#a8b3bf"  # Of links whose touch makes no success


def grasp_scene(alone: "Grasps", frame: Frame = MESH, *, closed: bool = True) -> trimesh.Scene:
    """Return the object and the hand of one grasp in a frame of the object [m].

    The nodes are `object`, and those of `hand_scene`. Closed, the hand stands as it settled; else it is open
    in the commanded pose.
    """
    poses = alone.settled_poses(frame) if closed else alone.poses(frame)
    joints = (alone.joints if closed else alone.pregrasp).astype(np.float64)
    made = hand_scene(alone.scene.gripper, poses[0], joints[0])
    body, middle = object_mesh(alone.scene), np.eye(4)
    if frame != COM:
        middle[:3, 3] = alone.scene.object.com_in_mesh
    made.add_geometry(_coloured(body, CLAY), node_name="object", geom_name="object", transform=middle)
    made.metadata |= {"frame": frame, "number": int(alone.numbers[0]), "closed": closed}
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
        colour = HAND_HUE if name in gripper.finger_links else PALM_COLOUR
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
