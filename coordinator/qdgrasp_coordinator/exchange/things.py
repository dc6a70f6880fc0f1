"""Hands and objects as far as poses depend on them: no convex parts are made, no mass is needed."""

from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.catalog import check_object, find_gripper, find_object, object_names
from qdgrasp_assets.files import named_path
from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_assets.solid import read_solid
from qdgrasp_protocol.spec import RunSpec


@dataclass(frozen=True)
class Thing:
    """The object that grasps are evaluated on."""

    com_in_mesh: Floats
    """(3,) [m]: the centre of mass in the frame of the mesh, as scaled."""
    scale: float
    """What the lengths in its mesh file are multiplied by to be metres."""


def hand_of(name: str) -> SceneGripper:
    """The gripper of the catalog with this name, or the one whose TOML file this is.

    Raises
    ------
    UnknownName, UnknownKey, AssetError
        As in `catalog.build_scene`.
    """
    return find_gripper(name).on_carrier("paper")


def thing_of(name: str, scale: float | None = None) -> Thing:
    """The object of the catalog with this name, or the one whose mesh file this is.

    Raises
    ------
    UnknownName, AssetError
        As in `catalog.build_scene`.
    """
    check_object(name)
    if name in object_names():
        com = find_object(RunSpec(gripper="", object=name, scale=scale)).com_in_mesh
    else:
        com = read_solid(named_path(name), scale).centre_of_mass
    return Thing(np.array(com), 1.0 if scale is None else scale)
