"""ACRONYM HDF5: matrices in the frame of the scaled mesh, a bit each for success, and what the object weighs.

Public description: Eppner et al. 2021, "ACRONYM: A Large-Scale Grasp Dataset Based on Simulation", and the
data's own keys. They are of parallel jaws: joints and synergies stand beside them in datasets of our own,
which other readers pass over, and so does the group `qdgrasp`.
"""

from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.body import Body, body
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.exchange.jaw import in_gripper, transforms, turned_about

TRANSFORMS = "grasps/transforms"
SUCCESSES = "grasps/qualities/flex/object_in_gripper"
JOINTS, SYNERGIES = "gripper/joint_names", "gripper/synergy_names"
STARTS, SYNERGY = "grasps/pregrasp_joint_positions", "grasps/synergy"
CONFIDENCE, NUMBERS, ABOUT = "grasps/confidence", "qdgrasp/number", "qdgrasp/about"
SCALE = "object/scale"


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
        SUCCESSES: in_gripper(grasps).astype(np.int8),
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
