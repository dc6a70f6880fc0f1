"""Data of the view in 3D: triangles of object and hand, and the best finds of each cell.

Of each 1 cm cell there is one voxel for every outcome and synergy that succeeded in it: so a filter that
leaves out some of these, or what has too low an eta, leaves exactly the cells in which something else was
found, and the best of that.

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
    """A mesh."""

    positions: str
    """(v, 3) little-endian float32 as base64."""
    indices: str
    """(f, 3) little-endian uint32 as base64, counter-clockwise from outside."""


class LinkMesh(Struct, frozen=True):
    """One link of a hand, with all of its collision shapes."""

    name: str
    finger: bool
    """Whether its contact makes a success."""
    mesh: TriangleMesh


class SuccessKind(Struct, frozen=True):
    """A kind of success."""

    outcome: int
    """The `Outcome` by its number."""
    words: str
    colour: str


class BrowserScene(Struct, frozen=True):
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
    kinds: Sequence[SuccessKind]
    """From worst to best."""
    mesh: TriangleMesh
    """Of the object."""
    links: Sequence[LinkMesh]
    """Of the hand."""
    origin: int = 0
    """That of the voxels that are found in it."""


class GraspView(Struct, frozen=True):
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


SUCCESS_KINDS = (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)


def browser_scene(scene: Scene, hand: HandGeometry) -> BrowserScene:
    """What stands in the view of a scene, `hand` being the scene's."""
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
        links=_links(hand),
    )


def grasp_view(find: np.void, hand: HandGeometry, stage: BrowserScene, commands: Sequence[str]) -> GraspView:
    """A success (a record of `storage.success_pages`) with the hand in its posture."""
    pose, joints = find["base_to_object"].astype(float), find["joints"].astype(float)
    frames = hand.frames(pose, joints)
    names = [joint.name for joint in hand.gripper.joints]
    return GraspView(
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
    return success_metrics.FITNESS_WORDS[kind - Outcome.DROPPED]


def _links(hand: HandGeometry) -> list[LinkMesh]:
    return [
        LinkMesh(name, name in hand.gripper.finger_links, _triangles(mesh.vertices, mesh.faces))
        for name, mesh in _meshes(hand).items()
    ]


def _meshes(hand: HandGeometry) -> dict[str, Mesh]:
    """All shapes of each link that has any, link frame."""
    shapes: dict[str, list[Mesh]] = {}
    for shape in hand.shapes:
        shapes.setdefault(shape.link, []).append(Mesh(shape.vertices, shape.faces))
    return {name: join(parts) for name, parts in shapes.items()}


def _triangles(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> TriangleMesh:
    positions, indices = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    return TriangleMesh(b64encode(positions).decode(), b64encode(indices).decode())


HEADER = struct.Struct("<4s5I")
"""The mark, n, the serial to ask from next, whether there is more at once, all voxels so far, the origin."""
MARK = b"QDG2"
COLUMNS = ("number", "eta", "cell", "synergy", "outcome")  # In the order of a page
MAX_PAGE_VOXELS = 1 << 16  # The most voxels on a page: about 1 MiB
MAX_VOXELS = 1 << 18  # The most voxels that are kept: 7 MiB. Finds in still more cells are left out.
MAX_CELL = np.iinfo(np.int16).max  # Cells: what lies farther out than 300 m is no find
VOXEL = np.dtype(
    [
        ("key", "<i8"),
        ("serial", "<u4"),
        ("number", "<u4"),
        ("eta", "<f4"),
        ("cell", "<i2", 3),
        ("synergy", "<i2"),
        ("outcome", "u1"),
    ]
)


class VoxelPages:
    """The best find of each cell, outcome and synergy: of the greatest eta, and of equals the earliest.

    Parameters
    ----------
    origin
        A number that tells these finds from those of another run or journal, uint32.
    """

    def __init__(self, origin: int = 0) -> None:
        self.origin = origin
        self.next = 0
        """The journal number up to which finds were inserted."""
        self.is_whole = True
        """Whether these were all that there were."""
        self._kept = np.zeros(0, VOXEL)  # by serial
        self._serial = 0

    def __len__(self) -> int:
        """How many there are."""
        return len(self._kept)

    def insert(self, found: SuccessTable, upto: int, *, is_whole: bool = True) -> None:
        """Add finds (n,), which are all up to journal number `upto`; they may be told again."""
        self.next, self.is_whole = upto, is_whole
        if len(found):
            voxels = _voxels_of(found)
            voxels["serial"] = self._serial + np.arange(len(voxels))
            self._kept = _best(np.concatenate([self._kept, voxels]))[:MAX_VOXELS]
            self._serial = int(self._kept["serial"][-1]) + 1 if len(self._kept) else 0

    def page(self, first: int) -> bytes:
        """The voxels that came with the serial `first` or a later one, as many as a page holds.

        Whoever asks on from the serial in the header, and lets what comes replace what has its cell, outcome
        and synergy, has them all.
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
    """One number for each cell, outcome and synergy: (n,)."""
    cell = voxels["cell"].astype(np.int64) + MAX_CELL
    synergy = voxels["synergy"].astype(np.int64) - NO_SYNERGY
    place = (cell[:, 0] << 32) | (cell[:, 1] << 16) | cell[:, 2]
    keys: NDArray[np.int64] = (((place << 3) | voxels["outcome"]) << 12) | synergy
    return keys


def _best(voxels: NDArray[np.void]) -> NDArray[np.void]:
    """The best one of each key, by serial; what is told again, and no better, is not new."""
    ordered = voxels[np.lexsort((voxels["serial"], voxels["number"], -voxels["eta"]))]
    _, first = np.unique(ordered["key"], return_index=True)
    kept: NDArray[np.void] = ordered[first]
    return kept[np.argsort(kept["serial"])]
