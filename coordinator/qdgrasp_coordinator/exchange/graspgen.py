"""GraspGen JSON: a folder to train from, with failures beside the grasps.

Public description: "GraspGen Grasp Dataset Format" and "GraspGen Gripper Description", v1.0.0. The folder has

* `grasp_data/NAME.json`             transforms and bits, and what the file says of itself
* `grasp_data/map_uuid_to_path.json` which object is in which file
* `splits/train.txt`, `valid.txt`    the object, in both: there is one
* `object_data/NAME.obj`             its mesh, in metres, in the frame that the transforms are told in
"""

from pathlib import Path
from typing import Any

import msgspec

from qdgrasp_assets.mesh import parts_to_obj
from qdgrasp_assets.rotation import conjugate
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.body import body
from qdgrasp_coordinator.exchange.frames import jaw_turn
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.exchange.jaw import in_gripper, transforms, turned_about

INDEX = "map_uuid_to_path.json"
DATA, SPLITS, OBJECTS = "grasp_data", "splits", "object_data"


def write(path: Path, grasps: Grasps, about: About) -> None:
    """Write grasps and failures as a GraspGen folder."""
    for folder in (DATA, SPLITS, OBJECTS):
        (path / folder).mkdir(parents=True)
    name = f"{about.object}.obj"
    data = f"{about.object}.json"
    (path / OBJECTS / name).write_bytes(parts_to_obj([body(grasps.scene.object, about.frame).mesh]))
    (path / DATA / data).write_bytes(msgspec.json.encode(_values(name, grasps, about)))
    (path / DATA / INDEX).write_bytes(msgspec.json.encode({name: data}))
    for split in ("train", "valid"):
        (path / SPLITS / f"{split}.txt").write_text(f"{name}\n", encoding="utf-8")


def is_ours(path: Path) -> bool:
    """Whether a folder is one that `write` made."""
    return path.is_dir() and (path / DATA / INDEX).is_file() and {p.name for p in path.iterdir()} == {
        DATA, SPLITS, OBJECTS,
    }  # fmt: skip


def _values(name: str, grasps: Grasps, about: About) -> dict[str, Any]:
    said = turned_about(about, grasps.scene.gripper)
    offset = [[0.0, 0.0, 0.0], conjugate(jaw_turn(grasps.scene.gripper)).tolist()]
    names = (*grasps.synergy_names, "")
    return {
        "object": {"file": name, "scale": 1.0},
        "grasps": {
            "transforms": transforms(grasps, about).tolist(),
            "object_in_gripper": in_gripper(grasps).tolist(),
        },
        "qdgrasp": said.values
        | {
            "transform_offset_from_asset_to_graspgen_convention": offset,
            "joint_names": grasps.joint_names,
            "grasps": {
                "number": grasps.numbers.tolist(),
                "fitness": grasps.fitness.tolist(),
                "eta": grasps.eta.tolist(),
                "joint_positions": grasps.joints.tolist(),
                "pregrasp_joint_positions": grasps.pregrasp.tolist(),
                "synergy": [names[label] for label in grasps.synergies.tolist()],
            },
        },
    }
