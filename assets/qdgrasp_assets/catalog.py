"""The catalog: names of grippers and objects, and the scene made of one of each."""

from dataclasses import replace
from pathlib import Path

from qdgrasp_assets import ycb
from qdgrasp_assets.gripper import Gripper, read_gripper
from qdgrasp_assets.scene import Scene
from qdgrasp_assets.surface import SURFACES
from qdgrasp_assets.target import Target, vector
from qdgrasp_protocol.spec import RunSpec

GRIPPERS = Path(__file__).parent / "grippers"


def build_scene(spec: RunSpec) -> Scene:
    """The scene that a run's spec names; the same spec and files give the same scene, bit for bit.

    Raises
    ------
    UnknownName
        A gripper or object that is neither known nor a file.
    AssetError
        One of its files cannot be used.
    """
    gripper = find_gripper(spec.gripper)
    target = find_object(spec)
    mesh, parts = target.centred_mesh, target.centred_parts
    surface = SURFACES[spec.protocol](mesh, parts, target.com_in_mesh, spec.surface_seed)
    low, high = mesh.bounds
    return Scene(
        protocol=spec.protocol,
        gripper=gripper.on_carrier(spec.protocol),
        object=target.packed(),
        points=surface.points.astype("<f4").tobytes(),
        normals=surface.normals.astype("<f4").tobytes(),
        finder_low=vector(surface.finder_low),
        finder_high=vector(surface.finder_high),
        object_low=vector(low),
        object_high=vector(high),
    )


def find_gripper(name: str) -> Gripper:
    """The built-in gripper of this name, or the one whose TOML file this is."""
    built_in = GRIPPERS / f"{name}.toml"
    if built_in.is_file():
        return read_gripper(built_in, name, "asset path" if name.startswith("ref_") else "built in")
    path = Path(name)
    return read_gripper(path, path.stem, path.name)


def find_object(spec: RunSpec) -> Target:
    """The object that a spec names, with the spec's mass and friction."""
    target = ycb.read_scan(spec.object.removeprefix(ycb.PREFIX), spec.protocol)
    if spec.mass is not None:
        target = replace(target, mass=spec.mass)
    if spec.friction is not None:
        target = replace(target, lateral_friction=spec.friction)
    return target
