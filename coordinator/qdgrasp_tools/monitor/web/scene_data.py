"""Data of the view in 3D: triangles of object and hand, and the best successes of each cell.

Every success is a voxel in its 1 cm cell, so that filters leave exactly the cells with another success that
passes, and the best of these.

A page of voxels is little-endian: the header `HEADER`, then of `n` voxels the columns `PAGE_COLUMNS`.
"""

import struct
from base64 import b64encode

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp
from trimesh import Trimesh
from trimesh.graph import smooth_shade

from qdgrasp_assets.geometry.mesh import Mesh, join, parse_parts
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import HandGeometry
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics import success_metrics
from qdgrasp_coordinator.metrics.cells import PER_METRE, cells
from qdgrasp_coordinator.metrics.grasp_quality import object_motion, settled_mask, settled_poses
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.rows import Outcome, trial_count
from qdgrasp_tools.rendering.views import object_surface
from qdgrasp_tools.report.run_report import known, row_contacts

SHARP = np.radians(45)  # faces that meet at a sharper angle are drawn with an edge
CLOSING_STEPS = 11  # Poses of the hand from the open one to the closed one
SUCCESS_KINDS = (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)


def browser_scene(scene: Scene, hand: HandGeometry) -> dict[str, object]:
    """Return everything in the view of a scene before the first success; `hand` is the scene's."""
    colours, around = success_metrics.FITNESS_COLOURS, parse_parts(scene.neighbours.decode())
    surface, margins = object_surface(scene)
    return {
        "gripper": scene.gripper.name,
        "object": scene.object.name,
        "base": scene.gripper.base_link,  # the hand's root link, which poses are of
        "com_in_mesh": scene.object.com_in_mesh,  # centre of mass in the mesh file's frame [m]; the same axes
        "synergies": [synergy.name for synergy in scene.gripper.synergies],
        "scored": trial_count(scene.protocol) > 0,  # successes have trials, and thus an eta
        "cell": 1 / PER_METRE,  # the edge of a cell [m]; cell k reaches from (k - 0.5) to (k + 0.5) times it
        "low": scene.object_low,  # the corners of the object's bounding box
        "high": scene.object_high,
        "reach": scene.gripper.reach,  # greatest distance of the hand's base from that box [m]
        "kinds": [  # of successes, from worst to best
            {"outcome": int(kind), "words": _words(kind), "colour": colours[kind - Outcome.DROPPED]}
            for kind in SUCCESS_KINDS
        ],
        "mesh": _triangles(surface, margins if scene.regions else None),
        "neighbours": _triangles(join(around)) if around else None,  # the fixed bodies around it
        "links": [  # of the hand; `finger`: its contact makes a success
            {"name": name, "finger": name in hand.gripper.finger_links, "mesh": _triangles(mesh)}
            for name, mesh in hand.link_meshes.items()
        ],
    }


def grasp_view(find: np.void, scene: Scene, hand: HandGeometry, margin: float = np.nan) -> dict[str, object]:
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
            "position_in_mesh": (pose[:3] + scene.object.com_in_mesh).tolist(),
            "quaternion": pose[3:].tolist(),
        }
        for pose in ends
    )
    moved, turned = (known(value) for value in object_motion(alone)[0])
    synergies = [synergy.name for synergy in scene.gripper.synergies]
    return {
        "number": int(find["number"]),  # in the journal
        "outcome": int(find["outcome"]),
        "fitness": float(find["fitness"]),
        "words": _words(Outcome(find["outcome"])),
        "eta": float(find["eta"]) if find["eta"] >= 0 else None,  # None where too few trials are recorded
        "trials": int(find["trials"]),
        "synergy": synergies[find["synergy"]] if 0 <= find["synergy"] < len(synergies) else "",
        "cell": cells(find["descriptor"]).tolist(),
        "base": scene.gripper.base_link,
        "commanded": commanded,  # before closing: with the joints `pregrasp`
        "settled": settled if is_settled else None,  # after closing, with `joints`; None: not recorded
        "pregrasp": dict(zip(names, postures[0].tolist(), strict=True)),
        "joints": dict(zip(names, postures[1].tolist(), strict=True)),
        "frames": _closing_frames(hand, ends, postures, {scene.gripper.base_link, *hand.link_meshes}),
        "finger_links": int(find["contacts"]),  # number of those that touch the object after closing
        "penetration": float(find["penetration"]),
        "moved": moved,  # how the object moved in the hand while it closed; None as `settled`
        "turned": turned,
        "margin": known(margin),  # None where it is not known
        "contacts": [  # some of them where there were many; `finger`: it makes a success
            each | {"finger": each["link"] in hand.gripper.finger_links}
            for each in row_contacts(find, hand.gripper)
        ],
    }


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


def _words(kind: Outcome) -> str:
    return success_metrics.FITNESS_WORDS[kind - Outcome.DROPPED]


def _triangles(mesh: Mesh, margins: NDArray[np.float32] | None = None) -> dict[str, str]:
    """Return a mesh whose faces share a vertex only where they meet at no sharp angle.

    In base64: positions (v, 3) as float32, and indices (f, 3) as uint32, counter-clockwise from outside; if
    given, margins of its vertices (v,) as float32.
    """
    smooth = smooth_shade(Trimesh(mesh.vertices, mesh.faces), SHARP, facet_minarea=None)
    columns = {"positions": smooth.vertices.astype("<f4"), "indices": smooth.faces.astype("<u4")}
    if margins is not None:
        columns["margins"] = margins[KDTree(mesh.vertices).query(smooth.vertices)[1]]
    return {name: b64encode(column.tobytes()).decode() for name, column in columns.items()}


HEADER = struct.Struct("<4s5I")
"""Mark, n, next serial, 1 if there is more at once, number of all voxels, origin."""
MARK = b"QDG4"
PAGE_COLUMNS = (
    ("number", "<u4"),  # Of the row in the journal
    ("eta", "<f4"),  # -1 where there is none
    ("penetration", "<f4"),  # [m]
    ("motion", "<f4"),  # How far the object moved while the hand closed [m]; NaN where it is not recorded
    ("cell", "<i2", 3),
    ("synergy", "<i2"),  # -1 for none
    ("outcome", "u1"),
    ("contacts", "u1"),  # Finger links that touch the object after closing
)
"""Columns of a page, in their order."""
MAX_PAGE_VOXELS = 1 << 15  # The most voxels on a page: about 1 MiB
MAX_VOXELS = 1 << 18  # From so many on those alone are added that are the first of their cell and outcome
MAX_CELL = np.iinfo(np.int16).max  # Cells; farther out than about 300 m there is no success
VOXEL = np.dtype(list(PAGE_COLUMNS))


class VoxelPages:
    """Successes by cell, in the order in which they came; one that comes again has another eta.

    Serials number the voxels, so that a browser can ask for those that it lacks.
    """

    def __init__(self, origin: int = 0) -> None:
        self.origin = origin  # A number that differs for another run or journal, uint32
        self.next = 0  # The journal number up to which successes were inserted
        self.is_whole = True  # True if these were all in the journal
        self._kept = np.zeros(0, VOXEL)  # by serial
        self._open: dict[int, float] = {}  # etas of those from `next` on, by number: they come again

    def insert(self, found: SuccessTable, upto: int, *, is_whole: bool = True) -> None:
        """Add successes (n,), all up to journal number `upto`; those from there on will come again."""
        seen, is_new = dict(self._open), np.zeros(len(found), dtype=bool)
        for place, (number, eta) in enumerate(
            zip(found["number"].tolist(), found["eta"].tolist(), strict=True)
        ):
            is_new[place] = seen.get(number) != eta
            seen[number] = eta
        voxels = _voxels_of(found[is_new])
        if len(self._kept) >= MAX_VOXELS:
            voxels = voxels[~np.isin(_keys(voxels), _keys(self._kept))]
        self._kept = np.concatenate([self._kept, voxels])
        self._open = {number: eta for number, eta in seen.items() if number >= upto}
        self.next, self.is_whole = upto, is_whole

    def page(self, first: int) -> bytes:
        """Return the voxels with the serial `first` or a later one, as many as a page holds.

        A reader that goes on from the serial in the header, and lets each voxel replace an earlier one of its
        number, gets them all.
        """
        shown = self._kept[first : first + MAX_PAGE_VOXELS]
        upto = min(first, len(self._kept)) + len(shown)
        more = upto < len(self._kept) or not self.is_whole
        header = HEADER.pack(MARK, len(shown), upto, more, len(self._kept), self.origin)
        return header + b"".join(shown[name].tobytes() for name, *_ in PAGE_COLUMNS)


def _voxels_of(found: SuccessTable) -> NDArray[np.void]:
    places = cells(found["descriptor"])
    near = (np.abs(places) <= MAX_CELL).all(axis=1)
    voxels, found = np.zeros(int(near.sum()), VOXEL), found[near]
    voxels["cell"] = places[near]
    for name in ("number", "eta", "penetration", "synergy", "outcome", "contacts"):
        voxels[name] = found[name]
    voxels["motion"] = object_motion(found)[:, 0]
    return voxels


def _keys(voxels: NDArray[np.void]) -> NDArray[np.int64]:
    """Return one number for each cell and outcome: (n,), packed into bit fields."""
    cell = voxels["cell"].astype(np.int64) + MAX_CELL
    keys: NDArray[np.int64] = (cell[:, 0] << 35) | (cell[:, 1] << 19) | (cell[:, 2] << 3) | voxels["outcome"]
    return keys
