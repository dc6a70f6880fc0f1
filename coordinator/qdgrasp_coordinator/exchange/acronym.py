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
from qdgrasp_coordinator.exchange.frames import from_matrices
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.exchange.jaw import transforms, turned_about
from qdgrasp_coordinator.exchange.told import (
    MOST,
    Told,
    Unusable,
    check_matrices,
    decoded,
    read_about,
    to_array,
)

TRANSFORMS = "grasps/transforms"
SUCCESSES = "grasps/qualities/flex/object_in_gripper"
JOINTS, SYNERGIES = "gripper/joint_names", "gripper/synergy_names"
STARTS, SYNERGY = "grasps/pregrasp_joint_positions", "grasps/synergy"
CONFIDENCE, NUMBERS, ABOUT = "grasps/confidence", "qdgrasp/number", "qdgrasp/about"
MOST_WORDS = 1000
"""Joints or synergies of a hand, at most."""


def write(path: Path, grasps: Grasps, about: About) -> None:
    """Write grasps as an ACRONYM file."""
    import h5py

    said = turned_about(about, grasps.scene.gripper)
    with h5py.File(path, "w") as file:
        for name, value in _object(about, body(grasps.scene.object, about.frame)).items():
            file[f"object/{name}"] = value
        for name, value in (_grasps(grasps, said) | _hand(grasps)).items():
            file[name] = value
        file[ABOUT] = said.json
        file["qdgrasp"].attrs.update(_attributes(said))


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
    import h5py

    try:
        with h5py.File(path) as file:
            matrices = _numbers(path, file, TRANSFORMS, (4, 4))
            check_matrices(path, matrices)
            count = len(matrices)
            about = read_about(path, file[ABOUT].asstr()[()]) if ABOUT in file else None
            quality = CONFIDENCE if CONFIDENCE in file else SUCCESSES
            return Told(
                names=_numbers(path, file, NUMBERS, (), count, np.arange(count)).astype(np.int64).astype(str),
                poses=from_matrices(matrices),
                is_turned=True,
                starts=_starts(path, file, count),
                synergies=_synergies(path, file, count),
                confidence=_numbers(path, file, quality, (), count, np.full(count, np.nan)),
                scale=_scalar(path, file, "object/scale"),
                mass=_scalar(path, file, "object/mass"),
                friction=_scalar(path, file, "object/friction"),
                about=about,
            )
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise Unusable(path, f"it is a damaged HDF5 file ({error})") from None


def _numbers(
    path: Path,
    file: Any,
    name: str,
    shape: tuple[int, ...],
    count: int | None = None,
    default: Floats | NDArray[np.int64] | None = None,
) -> Floats:
    """A dataset (n, *shape) of numbers; checked before it is read: a small file can promise a huge one."""
    if name not in file:
        if default is None:
            raise Unusable(path, f"it is HDF5, but not an ACRONYM file: it has no dataset '{name}'")
        return default.astype(np.float64)
    data = file[name]
    found = getattr(data, "shape", None)
    wanted = f"numbers of shape ({'n' if count is None else count}{''.join(f', {side}' for side in shape)})"
    if not found or found[1:] != shape or data.dtype.kind not in "fiub" or count not in (None, found[0]):
        raise Unusable(path, f"its dataset '{name}' must be {wanted}")
    if found[0] > MOST:
        raise Unusable(path, f"it has {found[0]} grasps; at most {MOST} are read")
    numbers: Floats = data[()].astype(np.float64)
    return numbers


def _scalar(path: Path, file: Any, name: str) -> float | None:
    """A number greater than zero; None: it is not told."""
    if name not in file:
        return None
    data = file[name]
    value = float(data[()]) if data.shape == () and data.dtype.kind in "fiu" else np.nan
    if not 0 < value < np.inf:
        raise Unusable(path, f"its dataset '{name}' must be a number greater than 0")
    return value


def _starts(path: Path, file: Any, count: int) -> dict[str, Floats]:
    """Joints that hands start from, by name (n,)."""
    if STARTS not in file:
        return {}
    names = _words(path, file, JOINTS)
    positions = _numbers(path, file, STARTS, (len(names),), count)
    return dict(zip(names, positions.T, strict=True))


def _synergies(path: Path, file: Any, count: int) -> NDArray[np.str_] | None:
    if SYNERGY not in file:
        return None
    names = [*_words(path, file, SYNERGIES), ""]
    labels = _numbers(path, file, SYNERGY, (), count).astype(np.int64)
    if ((labels < -1) | (labels >= len(names) - 1)).any():
        raise Unusable(path, f"its dataset '{SYNERGY}' must hold -1 or places in '{SYNERGIES}'")
    return np.array(names)[labels]


def _words(path: Path, file: Any, name: str) -> list[str]:
    data = file[name]
    if len(data.shape) != 1 or data.shape[0] > MOST_WORDS:
        raise Unusable(path, f"its dataset '{name}' must be a list of names")
    return [str(word) for word in data.asstr()[()]]


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
