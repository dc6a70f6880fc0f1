"""ACRONYM HDF5: matrices in the frame of the scaled mesh, a bit each for success, and what the object weighs.

Public description: Eppner et al. 2021, "ACRONYM: A Large-Scale Grasp Dataset Based on Simulation", and the
data's own keys. They are of parallel jaws: joints and synergies stand beside them in datasets of our own,
which other readers pass over, and so does the group `qdgrasp`.
"""

from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.body import Body, body
from qdgrasp_coordinator.exchange.checking import check_matrices
from qdgrasp_coordinator.exchange.frames import from_matrices
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.exchange.hdf5 import Datasets, opened
from qdgrasp_coordinator.exchange.jaw import transforms, turned_about
from qdgrasp_coordinator.exchange.told import Told, Unusable, decoded, read_about, to_array, to_words

TRANSFORMS = "grasps/transforms"
SUCCESSES = "grasps/qualities/flex/object_in_gripper"
JOINTS, SYNERGIES = "gripper/joint_names", "gripper/synergy_names"
STARTS, SYNERGY = "grasps/pregrasp_joint_positions", "grasps/synergy"
CONFIDENCE, NUMBERS, ABOUT = "grasps/confidence", "qdgrasp/number", "qdgrasp/about"


def write(path: Path, grasps: Grasps, about: About) -> None:
    """Write grasps as an ACRONYM file."""
    path.write_bytes(_bytes(grasps, turned_about(about, grasps.scene.gripper)))


def _bytes(grasps: Grasps, said: About) -> bytes:
    """The file; it is made in memory, as HDF5 does not survive a disk that is full."""
    import h5py

    with h5py.File("grasps", "w", driver="core", backing_store=False) as file:
        for name, value in _object(said, body(grasps.scene.object, said.frame)).items():
            file[f"object/{name}"] = value
        for name, value in (_grasps(grasps, said) | _hand(grasps)).items():
            file[name] = value
        file[ABOUT] = said.json
        file["qdgrasp"].attrs.update(_attributes(said))
        file.flush()
        made: bytes = file.id.get_file_image()
    return made


def _object(about: About, thing: Body) -> dict[str, object]:
    return {
        "file": about.object_file or about.object,
        "scale": about.object_scale,
        "mass": thing.mass,
        "density": thing.density,
        "friction": about.object_friction,
        "volume": thing.volume,
        "com": thing.com,
        "inertia": thing.inertia,
    }


def _grasps(grasps: Grasps, about: About) -> dict[str, Any]:
    return {
        TRANSFORMS: transforms(grasps, about),
        SUCCESSES: grasps.is_grasp.astype(np.int8),
        CONFIDENCE: grasps.confidence,
        "grasps/joint_positions": grasps.joints,
        STARTS: grasps.pregrasp,
        SYNERGY: grasps.synergies,
        NUMBERS: grasps.numbers,
        "qdgrasp/fitness": grasps.fitness,
        "qdgrasp/eta": grasps.eta,
        "qdgrasp/outcome": grasps.rows["outcome"],
    }


def _hand(grasps: Grasps) -> dict[str, Any]:
    hand = grasps.scene.gripper
    opening = {"gripper/configuration": np.array([hand.jaw.opening / 2])} if hand.jaw else {}
    return opening | {
        "gripper/type": hand.name,
        JOINTS: list(grasps.joint_names),
        SYNERGIES: list(grasps.synergy_names) or np.zeros(0, "S1"),
    }


def _attributes(about: About) -> dict[str, object]:
    """What the file says of itself, one attribute each; specs and digests are in the dataset `about`."""
    return {name: value for name, value in about.values.items() if name != "runs"}


def read(path: Path) -> Told:
    """The grasps in an ACRONYM file, of ours or of others.

    Raises
    ------
    Unusable
        It is damaged, or is another HDF5 file.
    """
    with opened(path) as file:
        matrices = file.numbers(TRANSFORMS, (4, 4))
        check_matrices(path, matrices)
        count, said = len(matrices), file.text(ABOUT)
        about = None if said is None else read_about(path, said)
        quality = CONFIDENCE if CONFIDENCE in file else SUCCESSES
        numbers = file.numbers(NUMBERS, (), count) if NUMBERS in file else np.arange(count)
        return Told(
            names=numbers.astype(np.int64).astype(str),
            poses=from_matrices(matrices),
            is_turned=True,
            frame=about.frame if about else None,
            gripper=about.gripper if about else file.text("gripper/type"),
            link=about.gripper_frame if about else None,
            starts=_starts(file, count),
            synergies=_synergies(path, file, count),
            confidence=file.numbers(quality, (), count) if quality in file else None,
            scale=file.scalar("object/scale"),
            mass=file.scalar("object/mass"),
            friction=file.scalar("object/friction"),
            about=about,
        )


def _starts(file: Datasets, count: int) -> dict[str, Floats]:
    """Joints that hands start from, by name (n,)."""
    if STARTS not in file:
        return {}
    names = file.words(JOINTS)
    positions = file.numbers(STARTS, (len(names),), count)
    return dict(zip(names, positions.T, strict=True))


def _synergies(path: Path, file: Datasets, count: int) -> NDArray[np.str_] | None:
    if SYNERGY not in file:
        return None
    names = to_words(path, "synergies", [*file.words(SYNERGIES), ""])
    labels = file.numbers(SYNERGY, (), count).astype(np.int64)
    if ((labels < -1) | (labels >= len(names) - 1)).any():
        raise Unusable(path, f"its dataset '{SYNERGY}' must hold -1 or places in '{SYNERGIES}'")
    return names[labels]


class Flat(Struct):
    """The flat JSON that readers of ACRONYM take too."""

    transforms: list[list[list[float]]]
    object_scale: float | None = None
    quality_flex_object_in_gripper: list[float | bool] | None = None


def read_json(path: Path, payload: bytes) -> Told:
    """The grasps in a flat JSON file.

    Raises
    ------
    Unusable
        It is another JSON file.
    """
    flat = decoded(path, payload, Flat)
    matrices = to_array(path, "transforms", flat.transforms, (4, 4))
    check_matrices(path, matrices)
    quality = flat.quality_flex_object_in_gripper
    return Told(
        names=np.arange(len(matrices)).astype(str),
        poses=from_matrices(matrices),
        is_turned=True,
        confidence=None if quality is None else to_array(path, "quality", quality, (), len(matrices)),
        scale=flat.object_scale,
    )
