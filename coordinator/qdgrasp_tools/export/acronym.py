"""ACRONYM HDF5: matrices in the scaled mesh's frame, success bits, the object's inertia.

Public description: Eppner et al. 2021, "ACRONYM: A Large-Scale Grasp Dataset Based on Simulation", and the
data's own keys. They are of parallel jaws: joints and synergies stand beside them in datasets of our own,
which other readers pass over, and so does the group `qdgrasp`.

In ACRONYM's simulation an open gripper stood at a transform and closed, and the motion of the object
meanwhile was recorded: `grasps/transforms` are the commanded poses, `grasps/settled_transforms` of our own
those after closing.

HDF5 files of others are read without trust: a dataset's shape and type are checked before it is read, and
nothing outside the file ever is.
"""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_tools.export.frames import Frame, from_matrices, object_solid
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.imported_grasps import (
    LONGEST,
    MOST_GRASPS,
    ImportedGrasps,
    UnreadableGrasps,
    check_matrices,
    decode_json,
    decode_metadata,
    to_array,
    to_words,
)
from qdgrasp_tools.export.metadata import (
    GraspMetadata,
    jaw_metadata,
    jaw_transforms,
    settled_jaw_transforms,
)

MOST_WORDS = 1000  # Words in a list, at most
LONGEST_TEXT = 1 << 26  # Bytes of a text, at most
LARGEST_CHUNK = 1 << 26  # Bytes of a chunk of a dataset, which are in memory at once
SMALL_BYTES, MOST_COMPRESSION = 1 << 24, 200
"""Datasets of more than so many bytes may not be so many times as large as their file."""


class Hdf5Datasets:
    """The datasets of an open file, by name."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file

    def __contains__(self, name: str) -> bool:
        return self._find(name) is not None

    def read_numbers(self, name: str, shape: tuple[int, ...] = (), count: int | None = None) -> Floats:
        """Read a dataset (n, *shape) of numbers, where n is `count` if that is given."""
        data = self._get(name)
        found = data.shape
        sides = "".join(f", {side}" for side in shape)
        if not found or found[1:] != shape or data.dtype.kind not in "fiub" or count not in (None, found[0]):
            expected = f"numbers of shape ({'n' if count is None else count}{sides})"
            raise UnreadableGrasps(self._path, f"its dataset '{name}' must be {expected}")
        if found[0] > MOST_GRASPS:
            raise UnreadableGrasps(self._path, f"it has {found[0]} grasps; at most {MOST_GRASPS} are read")
        if data.chunks and math.prod(data.chunks) * data.dtype.itemsize > LARGEST_CHUNK:
            raise UnreadableGrasps(self._path, f"its dataset '{name}' is stored in chunks that are too large")
        if data.nbytes > max(SMALL_BYTES, MOST_COMPRESSION * self._path.stat().st_size):
            raise UnreadableGrasps(self._path, f"its dataset '{name}' is far larger than the file")
        return np.asarray(data[()].astype(np.float64))

    def read_scalar(self, name: str) -> float | None:
        """Read a number; None: it is missing."""
        if name not in self:
            return None
        data = self._get(name)
        if data.shape != () or data.dtype.kind not in "fiu":
            raise UnreadableGrasps(self._path, f"its dataset '{name}' must be a number")
        return float(data[()])

    def read_text(self, name: str) -> str | None:
        """Read a text; None: it is missing."""
        if name not in self:
            return None
        data = self._get(name)
        if data.shape != () or data.dtype.itemsize > LONGEST_TEXT:
            raise UnreadableGrasps(self._path, f"its dataset '{name}' must be a text")
        return str(data.asstr()[()])

    def read_words(self, name: str) -> list[str]:
        """Read a list of words."""
        data = self._get(name)
        is_list = len(data.shape or ()) == 1 and data.shape[0] <= MOST_WORDS
        if not is_list or data.dtype.itemsize > 4 * LONGEST:
            raise UnreadableGrasps(self._path, f"its dataset '{name}' must be a list of names")
        return [str(data.asstr()[place]) for place in range(data.shape[0])]

    def _get(self, name: str) -> Any:
        data = self._find(name)
        if data is None:
            raise UnreadableGrasps(
                self._path, f"it is HDF5, but not an ACRONYM file: it has no dataset '{name}'"
            )
        return data

    def _find(self, name: str) -> Any | None:
        """Find a dataset along links that do not leave the file; None: it is missing."""
        import h5py

        node = self._file
        for part in name.split("/"):
            if not isinstance(node, h5py.Group) or not node.id.links.exists(part.encode()):
                return None
            if node.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
                raise UnreadableGrasps(
                    self._path, f"its '{name}' is a link to elsewhere, which is not followed"
                )
            node = node[part]
        if not isinstance(node, h5py.Dataset):
            raise UnreadableGrasps(self._path, f"its '{name}' is no dataset")
        if node.external or node.is_virtual:
            raise UnreadableGrasps(
                self._path, f"its dataset '{name}' lies in another file, which is not read"
            )
        return node


@contextmanager
def open_hdf5(path: Path) -> Iterator[Hdf5Datasets]:
    """Open the datasets of a file; damage found while they are read is UnreadableGrasps too."""
    import h5py

    try:
        with h5py.File(path) as file:
            yield Hdf5Datasets(path, file)
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise UnreadableGrasps(path, f"it is a damaged HDF5 file ({error})") from None


TRANSFORMS = "grasps/transforms"
SUCCESSES = "grasps/qualities/flex/object_in_gripper"
MOTION = "grasps/qualities/flex/object_motion_during_closing"
JOINTS, SYNERGIES = "gripper/joint_names", "gripper/synergy_names"
STARTS, SYNERGY = "grasps/pregrasp_joint_positions", "grasps/synergy"
LISTS = ("runs", "resting_poses")  # Metadata that is in the dataset `about` alone
CONFIDENCE, NUMBERS, ABOUT = "grasps/confidence", "qdgrasp/number", "qdgrasp/about"


def write(path: Path, grasps: Grasps, metadata: GraspMetadata) -> None:
    """Write grasps as an ACRONYM file."""
    import h5py

    ours = jaw_metadata(metadata, grasps.scene.gripper)
    # it is made in memory, as HDF5 does not survive a disk that is full
    with h5py.File("grasps", "w", driver="core", backing_store=False) as file:
        for name, value in _datasets(grasps, ours).items():
            file[name] = value
        file[ABOUT] = ours.json
        # metadata, one attribute each; specs and digests are in the dataset `about`
        for name, value in ours.values.items():
            if name not in LISTS:  # HDF5 has no nested attributes
                file["qdgrasp"].attrs[name] = json.dumps(value) if isinstance(value, dict) else value
        file.flush()
        path.write_bytes(file.id.get_file_image())


def _datasets(grasps: Grasps, metadata: GraspMetadata) -> dict[str, Any]:
    contacts = grasps.contacts_in(metadata.frame)
    hand, body = grasps.scene.gripper, object_solid(grasps.scene.object, metadata.frame)
    opening = {"gripper/configuration": np.array([hand.jaw.opening / 2])} if hand.jaw else {}
    return {
        "object/file": metadata.object_file or metadata.object,
        "object/scale": metadata.object_scale,
        "object/mass": body.mass,
        "object/density": body.density,
        "object/friction": metadata.object_friction,
        "object/volume": body.mesh.volume,
        "object/com": body.com,
        "object/inertia": body.inertia,
        TRANSFORMS: jaw_transforms(grasps.poses(metadata.frame), hand),
        "grasps/settled_transforms": settled_jaw_transforms(grasps, metadata.frame),
        SUCCESSES: grasps.is_grasp.astype(np.int8),
        f"{MOTION}_linear": grasps.motion[:, 0],
        f"{MOTION}_angular": grasps.motion[:, 1],
        CONFIDENCE: grasps.confidence,
        "grasps/joint_positions": grasps.joints,
        STARTS: grasps.pregrasp,
        SYNERGY: grasps.synergies,
        NUMBERS: grasps.numbers,
        "qdgrasp/fitness": grasps.fitness,
        "qdgrasp/eta": grasps.eta,
        "qdgrasp/trials": grasps.trials,
        "qdgrasp/outcome": grasps.rows["outcome"],
        "qdgrasp/penetration": grasps.rows["penetration"],
        "qdgrasp/margin": grasps.margin,
        "grasps/contact_links": contacts.links.astype(np.int16) - 1,
        "grasps/contact_points": contacts.points.astype(np.float32),
        "grasps/contact_normals": contacts.normals.astype(np.float32),
        "grasps/contact_forces": contacts.forces.astype(np.float32),
        **opening,
        **_approaches(grasps, metadata.frame),
        "gripper/type": hand.name,
        "gripper/link_names": list(hand.links) or np.zeros(0, "S1"),
        JOINTS: list(grasps.joint_names),
        SYNERGIES: list(grasps.synergy_names) or np.zeros(0, "S1"),
    }


def _approaches(grasps: Grasps, frame: Frame) -> dict[str, Any]:
    """Return how hands come to the commanded poses; nothing where that was not asked for."""
    if grasps.approach is None:
        return {}
    found = {
        "grasps/approach_transforms": jaw_transforms(grasps.approach_poses(frame), grasps.scene.gripper),
        "grasps/approach_directions": grasps.approach_directions,
        "grasps/approach_clear": grasps.reach.is_clear.astype(np.int8),
    }
    if grasps.approach.poses:
        reach = grasps.reach
        found["grasps/resting_poses"] = (reach.is_clear[:, None] & reach.is_above).astype(np.int8)
        found["qdgrasp/resting_pose_numbers"] = np.array(list(grasps.approach.poses), dtype=np.int64)
        found["qdgrasp/resting_probability"] = reach.probability
    return found


def read(path: Path) -> ImportedGrasps:
    """Read the grasps in an ACRONYM file, of ours or of others."""
    with open_hdf5(path) as file:
        matrices = file.read_numbers(TRANSFORMS, (4, 4))
        check_matrices(path, matrices)
        count, text = len(matrices), file.read_text(ABOUT)
        metadata = None if text is None else decode_metadata(path, text)
        quality = CONFIDENCE if CONFIDENCE in file else SUCCESSES
        numbers = file.read_numbers(NUMBERS, (), count) if NUMBERS in file else np.arange(count)
        return ImportedGrasps(
            names=numbers.astype(np.int64).astype(str),
            poses=from_matrices(matrices),
            has_jaw_axes=True,
            frame=metadata.frame if metadata else None,
            gripper=metadata.gripper if metadata else file.read_text("gripper/type"),
            link=metadata.gripper_frame if metadata else None,
            start_positions=_starts(file, count),
            synergies=_synergies(path, file, count),
            confidence=file.read_numbers(quality, (), count) if quality in file else None,
            scale=file.read_scalar("object/scale"),
            mass=file.read_scalar("object/mass"),
            friction=file.read_scalar("object/friction"),
            metadata=metadata,
        )


def _starts(file: Hdf5Datasets, count: int) -> dict[str, Floats]:
    """Read the joints that hands start from, by name (n,)."""
    if STARTS not in file:
        return {}
    names = file.read_words(JOINTS)
    positions = file.read_numbers(STARTS, (len(names),), count)
    return dict(zip(names, positions.T, strict=True))


def _synergies(path: Path, file: Hdf5Datasets, count: int) -> NDArray[np.str_] | None:
    if SYNERGY not in file:
        return None
    names = to_words(path, "synergies", [*file.read_words(SYNERGIES), ""])
    labels = file.read_numbers(SYNERGY, (), count).astype(np.int64)
    if ((labels < -1) | (labels >= len(names) - 1)).any():
        raise UnreadableGrasps(path, f"its dataset '{SYNERGY}' must hold -1 or places in '{SYNERGIES}'")
    return names[labels]


class FlatAcronym(Struct):
    """The flat JSON that readers of ACRONYM take too."""

    transforms: list[list[list[float]]]
    object_scale: float | None = None
    quality_flex_object_in_gripper: list[float | bool] | None = None


def read_json(path: Path, payload: bytes) -> ImportedGrasps:
    """Read the grasps in a flat JSON file."""
    flat = decode_json(path, payload, FlatAcronym)
    matrices = to_array(path, "transforms", flat.transforms, (4, 4))
    check_matrices(path, matrices)
    quality = flat.quality_flex_object_in_gripper
    return ImportedGrasps(
        names=np.arange(len(matrices)).astype(str),
        poses=from_matrices(matrices),
        has_jaw_axes=True,
        confidence=None if quality is None else to_array(path, "quality", quality, (), len(matrices)),
        scale=flat.object_scale,
    )
