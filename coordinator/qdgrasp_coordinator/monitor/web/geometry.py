"""Geometry for the browser: an object and a hand as triangles, and the hand where a find puts it.

Positions are metres in the object's centre-of-mass frame, those of a link in the link's own.
"""

from base64 import b64encode
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Mesh, join
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis import fitness
from qdgrasp_coordinator.analysis.hand import Hand
from qdgrasp_coordinator.counts.cells import PER_METRE, cells
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.trials import trials


class Triangles(Struct, frozen=True):
    """A mesh."""

    positions: str
    """(v, 3) little-endian float32 as base64."""
    indices: str
    """(f, 3) little-endian uint32 as base64, counter-clockwise from outside."""


class Link(Struct, frozen=True):
    """One link of a hand, with all of its collision shapes."""

    name: str
    finger: bool
    """Whether its contact makes a success."""
    mesh: Triangles


class Kind(Struct, frozen=True):
    """A kind of success."""

    outcome: int
    """The `Outcome` by its number."""
    words: str
    colour: str


class Stage(Struct, frozen=True):
    """All that stands in the view before anything is found."""

    gripper: str
    object: str
    base: str
    """The hand's root link: that of which poses are told."""
    com_in_mesh: Sequence[float]
    """(3,): the centre of mass in the mesh file's frame [m]; the axes are the same."""
    synergies: Sequence[str]
    """Those of the hand; none where all driven joints close."""
    scored: bool
    """Whether successes have trials, and so an eta."""
    cell: float
    """The edge of a cell [m]; cell k reaches from (k - 0.5) to (k + 0.5) times it."""
    low: Sequence[float]
    """(3,): the corners of the object's bounding box."""
    high: Sequence[float]
    reach: float
    """How far beyond that box the hand's base can stand [m]."""
    kinds: Sequence[Kind]
    """From worst to best."""
    mesh: Triangles
    """Of the object."""
    links: Sequence[Link]
    """Of the hand."""
    origin: int = 0
    """That of the voxels that are found in it."""


class Grasp(Struct, frozen=True):
    """All that is known of one find."""

    number: int
    """In the journal."""
    outcome: int
    fitness: float
    words: str
    """What the outcome means."""
    eta: float | None
    """The estimated probability of transfer; None where not all trials are recorded."""
    synergy: str
    """What closed the hand; empty: all driven joints."""
    cell: Sequence[int]
    """(3,)."""
    base: str
    """The hand's root link."""
    position: Sequence[float]
    """(3,): of the hand's root link [m]."""
    position_in_mesh: Sequence[float]
    """(3,): the same in the mesh file's frame [m]."""
    quaternion: Sequence[float]
    """(4,): of the hand's root link, xyzw; in both frames."""
    frame: list[float]
    """That of the hand's root link, 4 x 4, row by row."""
    joints: dict[str, float]
    """Positions of the finger joints [rad or m]."""
    links: dict[str, list[float]]
    """Each link's frame, 4 x 4, row by row."""
    commands: Sequence[str]
    """What shows and draws it."""


KINDS = (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)


def stage(scene: Scene, hand: Hand) -> Stage:
    """What stands in the view of a scene, `hand` being the scene's."""
    body = scene.object
    vertices = np.frombuffer(body.mesh_vertices, "<f4").reshape(-1, 3)
    return Stage(
        gripper=scene.gripper.name,
        object=body.name,
        base=scene.gripper.base_link,
        com_in_mesh=body.com_in_mesh,
        synergies=[synergy.name for synergy in scene.gripper.synergies],
        scored=trials(scene.protocol) > 0,
        cell=1 / PER_METRE,
        low=scene.object_low,
        high=scene.object_high,
        reach=scene.gripper.reach,
        kinds=[Kind(int(kind), _words(kind), fitness.COLOURS[kind - Outcome.DROPPED]) for kind in KINDS],
        mesh=_triangles(vertices, np.frombuffer(body.mesh_faces, "<u4")),
        links=_links(hand),
    )


def grasp(find: np.void, hand: Hand, stage: Stage, commands: Sequence[str]) -> Grasp:
    """A find (a record of `counts.finds`) on a stage, with the hand in its posture, and what shows it."""
    pose, joints = find["base_to_object"].astype(float), find["joints"].astype(float)
    frames = hand.frames(pose, joints)
    names = [joint.name for joint in hand.gripper.joints]
    return Grasp(
        number=int(find["number"]),
        outcome=int(find["outcome"]),
        fitness=float(find["fitness"]),
        words=_words(Outcome(find["outcome"])),
        eta=float(find["eta"]) if find["eta"] >= 0 else None,
        synergy=stage.synergies[find["synergy"]] if 0 <= find["synergy"] < len(stage.synergies) else "",
        cell=cells(find["descriptor"]).tolist(),
        base=stage.base,
        position=pose[:3].tolist(),
        position_in_mesh=(pose[:3] + stage.com_in_mesh).tolist(),
        quaternion=pose[3:].tolist(),
        frame=frames[stage.base].ravel().tolist(),
        joints=dict(zip(names, joints.tolist(), strict=True)),
        links={name: frames[name].ravel().tolist() for name in _meshes(hand)},
        commands=commands,
    )


def _words(kind: Outcome) -> str:
    return fitness.WORDS[kind - Outcome.DROPPED]


def _links(hand: Hand) -> list[Link]:
    return [
        Link(name, name in hand.gripper.finger_links, _triangles(mesh.vertices, mesh.faces))
        for name, mesh in _meshes(hand).items()
    ]


def _meshes(hand: Hand) -> dict[str, Mesh]:
    """All shapes of each link that has any, link frame."""
    shapes: dict[str, list[Mesh]] = {}
    for shape in hand.shapes:
        shapes.setdefault(shape.link, []).append(Mesh(shape.vertices, shape.faces))
    return {name: join(parts) for name, parts in shapes.items()}


def _triangles(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Triangles:
    positions, indices = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    return Triangles(b64encode(positions).decode(), b64encode(indices).decode())
