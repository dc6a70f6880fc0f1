"""Data of the view in 3D: triangles of object and hand, and the best successes of each cell.

Of each 1 cm cell there is one voxel for every outcome and synergy that succeeded in it: so a filter by
outcome, synergy or least eta leaves exactly the cells with another success, and the best of these.

A page of voxels is little-endian: the header `HEADER`, then of `n` voxels the journal numbers (uint32), etas
(float32, -1 where there is none), cells (3 x int16), synergies (int16, -1 for none) and outcomes (uint8).
"""

import struct
from base64 import b64encode
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Mesh, join
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics import success_metrics
from qdgrasp_coordinator.metrics.cells import PER_METRE, cells
from qdgrasp_coordinator.rendering.hand_geometry import HandGeometry
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.rows import NO_SYNERGY, Outcome, trial_count


class TriangleMesh(Struct, frozen=True):
    """A mesh for the browser."""

    positions: str  # (v, 3) little-endian float32 as base64
    indices: str  # (f, 3) little-endian uint32 as base64, counter-clockwise from outside


class LinkMesh(Struct, frozen=True):
    """One link of a hand, with all of its collision shapes."""

    name: str
    finger: bool  # True if its contact makes a success
    mesh: TriangleMesh


class SuccessKind(Struct, frozen=True):
    """A kind of success."""

    outcome: int  # The `Outcome` by its number
    words: str
    colour: str


class BrowserScene(Struct, frozen=True):
    """Everything in the view before the first success."""

    gripper: str
    object: str
    base: str  # The hand's root link, which poses are of
    com_in_mesh: Sequence[float]  # (3,): centre of mass in the mesh file's frame [m]; the same axes
    synergies: Sequence[str]  # Those of the hand; none where all driven joints close
    scored: bool  # True if successes have trials, and thus an eta
    cell: float  # The edge of a cell [m]; cell k reaches from (k - 0.5) to (k + 0.5) times it
    low: Sequence[float]  # (3,): the corners of the object's bounding box
    high: Sequence[float]
    reach: float  # Greatest distance of the hand's base from that box [m]
    kinds: Sequence[SuccessKind]  # From worst to best
    mesh: TriangleMesh  # Of the object
    links: Sequence[LinkMesh]  # Of the hand
    origin: int = 0  # The same number as that of its voxels


class GraspView(Struct, frozen=True):
    """Everything known of one success."""

    number: int  # In the journal
    outcome: int
    fitness: float
    words: str  # Meaning of the outcome
    eta: float | None  # The estimated probability of transfer; None where not all trials are recorded
    synergy: str  # Name of the synergy; empty: all driven joints close
    cell: Sequence[int]  # (3,)
    base: str  # The hand's root link
    position: Sequence[float]  # (3,): of the hand's root link [m]
    position_in_mesh: Sequence[float]  # (3,): the same in the mesh file's frame [m]
    quaternion: Sequence[float]  # (4,): of the hand's root link, xyzw; in both frames
    frame: list[float]  # Frame of the hand's root link, 4 x 4, row by row
    joints: dict[str, float]  # Positions of the finger joints [rad or m]
    links: dict[str, list[float]]  # Each link's frame, 4 x 4, row by row
    commands: Sequence[str]  # Commands that show and draw it


SUCCESS_KINDS = (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)


def browser_scene(scene: Scene, hand: HandGeometry) -> BrowserScene:
    """Return the view of a scene; `hand` is the scene's."""
    body = scene.object
    vertices = np.frombuffer(body.mesh_vertices, "<f4").reshape(-1, 3)
    return BrowserScene(
        gripper=scene.gripper.name,
        object=body.name,
        base=scene.gripper.base_link,
        com_in_mesh=body.com_in_mesh,
        synergies=[synergy.name for synergy in scene.gripper.synergies],
        scored=trial_count(scene.protocol) > 0,
        cell=1 / PER_METRE,
        low=scene.object_low,
        high=scene.object_high,
        reach=scene.gripper.reach,
        kinds=[
            SuccessKind(int(kind), _words(kind), success_metrics.FITNESS_COLOURS[kind - Outcome.DROPPED])
            for kind in SUCCESS_KINDS
        ],
        mesh=_triangles(vertices, np.frombuffer(body.mesh_faces, "<u4")),
        links=[
            LinkMesh(name, name in hand.gripper.finger_links, _triangles(mesh.vertices, mesh.faces))
            for name, mesh in _meshes(hand).items()
        ],
    )


def grasp_view(find: np.void, hand: HandGeometry, scene: BrowserScene, commands: Sequence[str]) -> GraspView:
    """Return a success (a record of `storage.success_pages`) with the hand in its posture."""
    pose, joints = find["base_to_object"].astype(float), find["joints"].astype(float)
    frames = hand.link_frames(pose, joints)
    names = [joint.name for joint in hand.gripper.joints]
    return GraspView(
        number=int(find["number"]),
        outcome=int(find["outcome"]),
        fitness=float(find["fitness"]),
        words=_words(Outcome(find["outcome"])),
        eta=float(find["eta"]) if find["eta"] >= 0 else None,
        synergy=scene.synergies[find["synergy"]] if 0 <= find["synergy"] < len(scene.synergies) else "",
        cell=cells(find["descriptor"]).tolist(),
        base=scene.base,
        position=pose[:3].tolist(),
        position_in_mesh=(pose[:3] + scene.com_in_mesh).tolist(),
        quaternion=pose[3:].tolist(),
        frame=frames[scene.base].ravel().tolist(),
        joints=dict(zip(names, joints.tolist(), strict=True)),
        links={name: frames[name].ravel().tolist() for name in _meshes(hand)},
        commands=commands,
    )


def _words(kind: Outcome) -> str:
    return success_metrics.FITNESS_WORDS[kind - Outcome.DROPPED]


def _meshes(hand: HandGeometry) -> dict[str, Mesh]:
    """Return the shapes of each link that has any, joined, link frame."""
    shapes: dict[str, list[Mesh]] = {}
    for shape in hand.shapes:
        shapes.setdefault(shape.link, []).append(Mesh(shape.vertices, shape.faces))
    return {name: join(parts) for name, parts in shapes.items()}


def _triangles(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> TriangleMesh:
    positions, indices = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    return TriangleMesh(b64encode(positions).decode(), b64encode(indices).decode())


HEADER = struct.Struct("<4s5I")
"""Mark, n, next serial, 1 if there is more at once, number of all voxels, origin."""
MARK = b"QDG2"
COLUMNS = ("number", "eta", "cell", "synergy", "outcome")  # In the order of a page
MAX_PAGE_VOXELS = 1 << 16  # The most voxels on a page: about 1 MiB
MAX_VOXELS = 1 << 18  # The most voxels that are kept: 7 MiB; further ones are left out
MAX_CELL = np.iinfo(np.int16).max  # Cells; farther out than about 300 m there is no success
VOXEL = np.dtype([
    ("key", "<i8"), ("serial", "<u4"), ("number", "<u4"), ("eta", "<f4"),
    ("cell", "<i2", 3), ("synergy", "<i2"), ("outcome", "u1"),
])  # fmt: skip


class VoxelPages:
    """The best success of each cell, outcome and synergy: of the greatest eta, then earliest.

    Serials number the voxels in the order in which they came or improved, so that a browser can ask for those
    that it lacks.
    """

    def __init__(self, origin: int = 0) -> None:
        self.origin = origin  # A number that differs for another run or journal, uint32
        self.next = 0  # The journal number up to which successes were inserted
        self.is_whole = True  # True if these were all in the journal
        self._kept = np.zeros(0, VOXEL)  # by serial
        self._serial = 0

    def __len__(self) -> int:
        """Number of voxels."""
        return len(self._kept)

    def insert(self, found: SuccessTable, upto: int, *, is_whole: bool = True) -> None:
        """Add successes (n,), all up to journal number `upto`; they may come again."""
        self.next, self.is_whole = upto, is_whole
        if len(found):
            voxels = _voxels_of(found)
            voxels["serial"] = self._serial + np.arange(len(voxels))
            self._kept = _best(np.concatenate([self._kept, voxels]))[:MAX_VOXELS]
            self._serial = int(self._kept["serial"][-1]) + 1 if len(self._kept) else 0

    def page(self, first: int) -> bytes:
        """Return the voxels with the serial `first` or a later one, as many as a page holds.

        A reader that goes on from the serial in the header, and lets each voxel replace an earlier one of its
        cell, outcome and synergy, gets them all.
        """
        start = int(np.searchsorted(self._kept["serial"], first))
        shown = self._kept[start : start + MAX_PAGE_VOXELS]
        upto = int(shown["serial"][-1]) + 1 if len(shown) else self._serial
        more = start + MAX_PAGE_VOXELS < len(self._kept) or not self.is_whole
        header = HEADER.pack(MARK, len(shown), upto, more, len(self._kept), self.origin)
        return header + b"".join(shown[name].tobytes() for name in COLUMNS)


def _voxels_of(found: SuccessTable) -> NDArray[np.void]:
    places = cells(found["descriptor"])
    near = (np.abs(places) <= MAX_CELL).all(axis=1)
    voxels = np.zeros(int(near.sum()), VOXEL)
    voxels["cell"] = places[near]
    for name in ("number", "eta", "synergy", "outcome"):
        voxels[name] = found[name][near]
    voxels["key"] = _keys(voxels)
    return voxels


def _keys(voxels: NDArray[np.void]) -> NDArray[np.int64]:
    """Return one number for each cell, outcome and synergy: (n,), packed into bit fields."""
    cell = voxels["cell"].astype(np.int64) + MAX_CELL
    synergy = voxels["synergy"].astype(np.int64) - NO_SYNERGY
    place = (cell[:, 0] << 32) | (cell[:, 1] << 16) | cell[:, 2]
    keys: NDArray[np.int64] = (((place << 3) | voxels["outcome"]) << 12) | synergy
    return keys


def _best(voxels: NDArray[np.void]) -> NDArray[np.void]:
    """Return the best voxel of each key, by serial; a repeated one keeps its serial."""
    ordered = voxels[np.lexsort((voxels["serial"], voxels["number"], -voxels["eta"]))]
    _, first = np.unique(ordered["key"], return_index=True)
    kept: NDArray[np.void] = ordered[first]
    return kept[np.argsort(kept["serial"])]
