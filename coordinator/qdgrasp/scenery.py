"""Scenery: which hand meets which object, as keyword arguments of whatever evaluates."""

import os
from typing import Any, Required, TypedDict

from qdgrasp_coordinator.runs.preparation import located
from qdgrasp_protocol.errors import InputError, UnknownName
from qdgrasp_protocol.spec import ProtocolName, RunSpec, run_spec


class Scenery(TypedDict, total=False):
    """A gripper, an object and an evaluation protocol; what is left out is as `qdgrasp run` has it."""

    gripper: Required[str | os.PathLike[str]]
    """A built-in gripper, one on the asset path, or a gripper's TOML file."""
    object: Required[str | os.PathLike[str]]
    """A built-in object, one on the asset path, or a mesh file."""
    mass: float | None
    """Of the object [kg]; needed for a mesh file."""
    scale: float | None
    """Metres to a unit of the mesh file: 0.001 where it is in millimetres; 1."""
    friction: float | None
    """The object's lateral friction coefficient; 0.5."""
    protocol: ProtocolName
    """"paper", "released" or "robust" (docs/protocols.md)."""
    surface_seed: int
    """Seed of the surface points; 0."""


def spec_of(scenery: Scenery, **more: Any) -> RunSpec:
    """The spec that keyword arguments stand for, files as absolute paths.

    Raises
    ------
    InputError
        A keyword that is none or that is missing, or a value that cannot be; what can is named.
    """
    for name in scenery:
        if name not in Scenery.__annotations__:
            raise UnknownName("keyword", name, Scenery.__annotations__)
    for name in sorted(Scenery.__required_keys__):
        if scenery.get(name) is None:
            raise InputError(f"qdgrasp: '{name}' is missing; say {name}=... with a name or a file.")
    values = {name: value for name, value in ({**scenery, **more}).items() if value is not None}
    for name in ("gripper", "object"):
        if isinstance(values.get(name), os.PathLike):
            values[name] = os.fspath(values[name])
        if name in values:
            values[name] = located(values[name])
    return run_spec(values, "qdgrasp")
