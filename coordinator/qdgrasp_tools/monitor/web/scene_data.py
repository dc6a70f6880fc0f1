"""Data of the view in 3D: triangles of object and hand, and the best successes of each cell.

Every success is a voxel in its 1 cm cell, so that filters leave exactly the cells with another success that
passes, and the best of these.

A page of voxels is little-endian: the header `HEADER`, then of `n` voxels the columns `PAGE_COLUMNS`.
"""

import struct
from base64 import b64encode
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp
from trimesh import Trimesh
from trimesh.graph import smooth_shade

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import HandGeometry
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics import success_metrics
from qdgrasp_coordinator.metrics.cells import PER_METRE, cells
from qdgrasp_coordinator.metrics.grasp_quality import object_motion, settled_mask, settled_poses
from qdgrasp_coordinator.storage.engine_table import EngineTable, holding_in_all
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.rows import CONTACT_VALUES, NO_SYNERGY, Outcome, trial_count
from qdgrasp_protocol.spec import engine_names


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
    engines: Sequence[str] = ()  # Those that successes were tried in, the first one first
    origin: int = 0  # The same number as that of its voxels


SHARP = np.radians(45)  # faces that meet at a sharper angle are drawn with an edge
CLOSING_STEPS = 11  # Poses of the hand from the open one to the closed one
SUCCESS_KINDS = (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)


def browser_scene(scene: Scene, hand: HandGeometry) -> BrowserScene:
    """Return the view of a scene; `hand` is the scene's."""
    body = scene.object
    vertices = body.vertices
    return BrowserScene(
        gripper=scene.gripper.name,
        object=body.name,
        base=scene.gripper.base_link,
        com_in_mesh=body.com_in_mesh,
        synergies=[synergy.name for synergy in scene.gripper.synergies],
        scored=trial_count(scene.protocol) > 0,
        engines=engine_names(scene.engine),
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
            for name, mesh in hand.link_meshes.items()
        ],
    )


def grasp_view(
    find: np.void, hand: HandGeometry, scene: BrowserScene, commands: Sequence[str], margin: float = np.nan
) -> dict[str, object]:
    """Return everything known of a success, a record of `storage.success_pages`.

    Lengths are in m, angles in rad and forces in N, in the object's centre-of-mass frame.
    """
    alone = find.reshape(1)
    ends = np.concatenate([alone["base_to_object"].astype(np.float64), settled_poses(alone)])
    postures = np.array([find["pregrasp"], find["joints"]], dtype=np.float64)
    names, is_settled = [joint.name for joint in hand.gripper.joints], bool(settled_mask(alone)[0])
    commanded, settled = (  # poses of the hand's root link, quaternions xyzw
        {
            "position": pose[:3].tolist(),
            "position_in_mesh": (pose[:3] + scene.com_in_mesh).tolist(),
            "quaternion": pose[3:].tolist(),
        }
        for pose in ends
    )
    moved, turned = (_known(value) for value in object_motion(alone)[0])
    return {
        "number": int(find["number"]),  # in the journal
        "outcome": int(find["outcome"]),
        "fitness": float(find["fitness"]),
        "words": _words(Outcome(find["outcome"])),
        "eta": float(find["eta"]) if find["eta"] >= 0 else None,  # None where too few trials are recorded
        "trials": int(find["trials"]),
        "synergy": scene.synergies[find["synergy"]] if 0 <= find["synergy"] < len(scene.synergies) else "",
        "cell": cells(find["descriptor"]).tolist(),
        "base": scene.base,
        "commanded": commanded,  # before closing: with the joints `pregrasp`
        "settled": settled if is_settled else None,  # after closing, with `joints`; None: not recorded
        "pregrasp": dict(zip(names, postures[0].tolist(), strict=True)),
        "joints": dict(zip(names, postures[1].tolist(), strict=True)),
        "frames": _closing_frames(hand, ends, postures, {scene.base, *hand.link_meshes}),
        "finger_links": int(find["contacts"]),  # number of those that touch the object after closing
        "penetration": float(find["penetration"]),
        "moved": moved,  # how the object moved in the hand while it closed; None as `settled`
        "turned": turned,
        "margin": _known(margin),  # None where it is not known
        "contacts": _contacts(find, hand),  # some of them where there were many
        "commands": commands,  # that show and draw it
    }


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _closing_frames(
    hand: HandGeometry, ends: Floats, postures: Floats, links: set[str]
) -> dict[str, list[list[float]]]:
    """Return poses (steps, 7) of links while the hand goes from its first pose to its second.

    Positions and joints change evenly, orientations by the shortest rotation.
    """
    shares = np.linspace(0.0, 1.0, CLOSING_STEPS)
    first, last = ends[:, :3]
    turns = Slerp([0.0, 1.0], Rotation.from_quat(ends[:, 3:]))(shares).as_quat()
    poses = np.column_stack([first + shares[:, None] * (last - first), turns])
    joints = postures[0] + shares[:, None] * (postures[1] - postures[0])
    frames = hand.link_frames(poses, joints)
    return {name: _as_poses(frames[name]) for name in sorted(links)}


def _as_poses(frames: Floats) -> list[list[float]]:
    quaternions = Rotation.from_matrix(frames[:, :3, :3]).as_quat()
    poses: list[list[float]] = np.column_stack([frames[:, :3, 3], quaternions]).round(7).tolist()
    return poses


def _contacts(find: np.void, hand: HandGeometry) -> list[dict[str, object]]:
    """Return the contacts after closing: points, unit normals into the object, forces."""
    gripper, values = hand.gripper, find["contact_points"].astype(float).reshape(-1, CONTACT_VALUES).tolist()
    links = [gripper.links[number - 1] if number else "" for number in find["contact_links"].tolist()]
    return [
        {
            "link": link,
            "finger": link in gripper.finger_links,  # whether its contact makes a success
            "point": parts[:3],
            "normal": parts[3:6],
            "force": parts[6],
        }
        for link, parts in zip(links, values, strict=True)
        if link
    ]


def _words(kind: Outcome) -> str:
    return success_metrics.FITNESS_WORDS[kind - Outcome.DROPPED]


def _triangles(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> TriangleMesh:
    """Return a mesh whose faces share a vertex only where they meet at no sharp angle."""
    mesh = Trimesh(vertices, faces.reshape(-1, 3))
    smooth = smooth_shade(mesh, SHARP, facet_minarea=None)
    positions, indices = smooth.vertices.astype("<f4").tobytes(), smooth.faces.astype("<u4").tobytes()
    return TriangleMesh(b64encode(positions).decode(), b64encode(indices).decode())


HEADER = struct.Struct("<4s5I")
"""Mark, n, next serial, 1 if there is more at once, number of all voxels, origin."""
MARK = b"QDG4"
PAGE_COLUMNS = (
    ("number", "<u4"),  # Of the row in the journal
    ("eta", "<f4"),  # -1 where there is none
    ("penetration", "<f4"),  # [m]
    ("motion", "<f4"),  # How far the object moved while the hand closed [m]; NaN where it is not recorded
    ("margin", "<f4"),  # NaN where it is not known, or not yet
    ("cell", "<i2", 3),
    ("synergy", "<i2"),  # -1 for none
    ("outcome", "u1"),
    ("contacts", "u1"),  # Finger links that touch the object after closing
    ("in_all", "u1"),  # 1 if it holds in each engine that the scene names
)
"""Columns of a page, in their order."""
MAX_PAGE_VOXELS = 1 << 15  # The most voxels on a page: about 1 MiB
MAX_VOXELS = 1 << 18  # The most voxels that are kept, 12 MiB; of more, the best of each cell come first
MAX_CELL = np.iinfo(np.int16).max  # Cells; farther out than about 300 m there is no success
VOXEL = np.dtype([("key", "<i8"), ("serial", "<u4"), *PAGE_COLUMNS])
NO_TABLES: Mapping[str, EngineTable] = {}


class VoxelPages:
    """Successes by cell; of too many, first the best of each cell, outcome and synergy.

    The best is that of the greatest eta, of equals the earliest. Serials number the voxels in the order in
    which they came or improved, so that a browser can ask for those that it lacks.
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

    def insert(
        self,
        found: SuccessTable,
        upto: int,
        *,
        is_whole: bool = True,
        tables: Mapping[str, EngineTable] = NO_TABLES,
    ) -> None:
        """Add successes (n,), all up to journal number `upto`; they may come again.

        `tables` are the verdicts of other engines on them.
        """
        self.next, self.is_whole = upto, is_whole
        if len(found):
            voxels = _voxels_of(found, tables)
            _, known, again = np.intersect1d(self._kept["number"], voxels["number"], return_indices=True)
            voxels["margin"][again] = self._kept["margin"][known]
            voxels["serial"] = self._serial + np.arange(len(voxels))
            self._kept = _thinned(_latest(np.concatenate([self._kept, voxels])))
            self._serial = int(self._kept["serial"][-1]) + 1 if len(self._kept) else 0

    def lacking_margins(self) -> NDArray[np.uint32]:
        """Journal numbers (n,) of grasps whose margin is to be computed next, in order.

        Of those that settled and have none: the best of each key, and the others once these have one.
        """
        is_lacking = ~np.isnan(self._kept["motion"]) & np.isnan(self._kept["margin"])
        is_first = is_lacking & _best_mask(self._kept)
        numbers: NDArray[np.uint32] = self._kept["number"][is_first if is_first.any() else is_lacking]
        return np.sort(numbers)

    def add_margins(self, numbers: NDArray[np.uint32], margins: Floats) -> None:
        """Set the margins (n,) of grasps by journal number (n,); later pages have them again."""
        _, known, given = np.intersect1d(self._kept["number"], numbers, return_indices=True)
        again = self._kept[known]
        again["margin"] = margins[given]
        again["serial"] = self._serial + np.arange(len(again))
        self._kept = np.concatenate([np.delete(self._kept, known), again])
        self._serial += len(again)

    def page(self, first: int) -> bytes:
        """Return the voxels with the serial `first` or a later one, as many as a page holds.

        A reader that goes on from the serial in the header, and lets each voxel replace an earlier one of its
        number, gets them all.
        """
        start = int(np.searchsorted(self._kept["serial"], first))
        shown = self._kept[start : start + MAX_PAGE_VOXELS]
        upto = int(shown["serial"][-1]) + 1 if len(shown) else self._serial
        more = start + MAX_PAGE_VOXELS < len(self._kept) or not self.is_whole
        header = HEADER.pack(MARK, len(shown), upto, more, len(self._kept), self.origin)
        return header + b"".join(shown[name].tobytes() for name, *_ in PAGE_COLUMNS)


def _voxels_of(found: SuccessTable, tables: Mapping[str, EngineTable]) -> NDArray[np.void]:
    places = cells(found["descriptor"])
    near = (np.abs(places) <= MAX_CELL).all(axis=1)
    voxels, found = np.zeros(int(near.sum()), VOXEL), found[near]
    voxels["cell"] = places[near]
    for name in ("number", "eta", "penetration", "synergy", "outcome", "contacts"):
        voxels[name] = found[name]
    voxels["in_all"] = holding_in_all(tables, found["number"], found["outcome"])
    voxels["motion"] = object_motion(found)[:, 0]
    voxels["margin"] = np.nan  # of thousands of grasps it takes many seconds: `add_margins`
    voxels["key"] = _keys(voxels)
    return voxels


def _keys(voxels: NDArray[np.void]) -> NDArray[np.int64]:
    """Return one number for each cell, outcome and synergy: (n,), packed into bit fields.

    A grasp that holds in all engines has an outcome of its own, 0.
    """
    cell = voxels["cell"].astype(np.int64) + MAX_CELL
    synergy = voxels["synergy"].astype(np.int64) - NO_SYNERGY
    outcome = np.where(voxels["in_all"], 0, voxels["outcome"])
    place = (cell[:, 0] << 32) | (cell[:, 1] << 16) | cell[:, 2]
    keys: NDArray[np.int64] = (((place << 3) | outcome) << 12) | synergy
    return keys


def _latest(voxels: NDArray[np.void]) -> NDArray[np.void]:
    """Return the voxel of the greatest eta of each number; a repeated one keeps its serial."""
    ordered = voxels[np.lexsort((voxels["serial"], -voxels["eta"]))]
    _, first = np.unique(ordered["number"], return_index=True)
    kept: NDArray[np.void] = ordered[first]
    return kept[np.argsort(kept["serial"])]


def _thinned(voxels: NDArray[np.void]) -> NDArray[np.void]:
    """Return at most `MAX_VOXELS`, by serial: first the best of each key, then the earliest."""
    if len(voxels) <= MAX_VOXELS:
        return voxels
    kept = np.argsort(~_best_mask(voxels), kind="stable")[:MAX_VOXELS]
    return voxels[np.sort(kept)]


def _best_mask(voxels: NDArray[np.void]) -> NDArray[np.bool_]:
    """(n,): True for the voxel of the greatest eta of each key, of equals the earliest."""
    order = np.lexsort((voxels["number"], -voxels["eta"]))
    _, first = np.unique(voxels["key"][order], return_index=True)
    is_best = np.zeros(len(voxels), dtype=bool)
    is_best[order[first]] = True
    return is_best
