"""Checks what a program hands in before anything is started or written.

A gripper, an object and a protocol as keyword arguments; and arrays of genomes.
"""

import os
from typing import Any, Literal, Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.genes import PRIOR_GENES, layout
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.scheduler.run_plan import absolute_asset
from qdgrasp_protocol.errors import ImpossibleValue, InputError, UnknownName
from qdgrasp_protocol.rows import GIVEN, Genomes, Layout
from qdgrasp_protocol.spec import BaseName, EngineChoice, ProtocolName, RunSpec, run_spec, usual_engine


def plain_number(value: Any) -> Any:
    """Return a scalar of numpy as the number that it is, and anything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


class SceneArguments(TypedDict, total=False):
    """Gripper, object and evaluation protocol; defaults of `qdgrasp run`, but for `protocol`."""

    gripper: Required[str | os.PathLike[str]]
    """A built-in gripper, one on the asset path, or a gripper's TOML file."""
    object: Required[str | os.PathLike[str]]
    """A built-in object, one on the asset path, or a mesh file."""
    mass: float | None
    """Mass of the object [kg]; needed for a mesh file."""
    scale: float | None
    """Metres to a unit of the mesh file: 0.001 where it is in millimetres; 1."""
    friction: float | None
    """The object's lateral friction coefficient; 0.5."""
    protocol: ProtocolName
    """"paper", "physical", "lift", "released" or "robust" (docs/protocols.md); "paper"."""
    base: BaseName
    """The protocol that the trials of "robust" disturb, "paper" or "physical"; "paper"."""
    engine: EngineChoice | None
    """The physics engine, "bullet" or, but for "released", "mujoco", or both in their order, as in
    "bullet,mujoco"; of "physical" "mujoco-warp" too; "bullet" where PyBullet is installed,
    else "mujoco"."""
    approach_distance: float | None
    """Distance [m] from which the open hand comes along its approach axis, touching nothing; 0, or 0.1 with a
    resting pose."""
    resting_pose: int | Literal["any"] | None
    """How the object rests on a table that the hand comes above (`qdgrasp asset resting-poses`); "any": in
    one of these ways at least; None: there is no table."""
    scene: str | os.PathLike[str] | None
    """A file of the fixed bodies around the object (docs/where.md); None: there are none."""
    surface_seed: int
    """Seed of the surface points; 0."""


def spec_from_arguments(scene_arguments: SceneArguments, **more: Any) -> RunSpec:
    """Return the spec of keyword arguments, files as absolute paths; InputError for wrong ones."""
    for name in scene_arguments:
        if name not in SceneArguments.__annotations__:
            raise UnknownName("keyword", name, SceneArguments.__annotations__)
    for name in sorted(SceneArguments.__required_keys__):
        if scene_arguments.get(name) is None:
            raise InputError(f"qdgrasp: '{name}' is missing; say {name}=... with a name or a file.")
    given = {**scene_arguments, **more}
    values = {name: plain_number(value) for name, value in given.items() if value is not None}
    for name in ("gripper", "object", "scene"):
        if isinstance(values.get(name), os.PathLike):
            values[name] = os.fspath(values[name])
        if name in values:
            values[name] = absolute_asset(values[name])
    return run_spec(usual_engine(values.get("protocol")) | values, "qdgrasp")


def layout_of(scene: Scene, prior: str) -> Layout:
    """Return the genes of a prior with a scene.

    Raises UnknownName if there is no such prior, JawNeeded if it is for two-finger hands, and this is none.
    """
    if prior not in PRIOR_GENES:
        raise UnknownName("prior", prior, PRIOR_GENES)
    return layout(scene, prior)


def check_genomes(values: ArrayLike, layout: Layout) -> Genomes:
    """Return genomes (n, d) as float32.

    Raises ImpossibleValue for another shape, or a number that is not finite or, but for the prior `given`,
    outside [-1, 1].
    """
    expected = f"numbers of shape (n, {len(layout)}): {', '.join(layout.names)}"
    try:
        genomes: Genomes = np.array(values, dtype=np.float32, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"genomes must be {expected}; {error}.") from None
    if genomes.ndim != 2 or genomes.shape[1] != len(layout):
        raise ImpossibleValue("genomes", genomes.shape, expected)
    limit = np.inf if layout.prior == GIVEN else 1.0
    wrong = genomes[~(np.isfinite(genomes) & (np.abs(genomes) <= limit))]
    if len(wrong):
        bounds = "finite" if layout.prior == GIVEN else "in [-1, 1]"
        raise ImpossibleValue("genomes", float(wrong[0]), f"{bounds} ({len(wrong)} numbers are not)")
    return genomes
