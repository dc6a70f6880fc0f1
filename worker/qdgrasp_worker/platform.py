"""The platform: all that decides the bits of results besides scene and genome."""

import hashlib
import os
import platform as machine
from importlib import import_module
from importlib.metadata import version

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import QdgraspError
from qdgrasp_protocol.rows import RESULT, pack
from qdgrasp_protocol.spec import DEFAULT_ENGINE, DEVICE_ENGINE, ENGINES_VARIABLE, Device, RunSpec, has_bullet
from qdgrasp_worker.evaluator import DEVICE_MODULE, Evaluator, make_evaluator

EVALUATION = 4
"""Number of what an evaluation computes; raised when golden digests of rows change on purpose."""
PROBES = 16
LEAST_AGREEING = 14  # Probes that have the same outcome on a device as in MuJoCo, at least
PROBE_GRASPS = 6
PROBE_AIM = (-1.0, -0.5)
"""Genes nu and d of the first probes: straight above, so near that they reach the shakes."""
PHYSICAL_PROBES = slice(4, None)
"""The probes that engines beside Bullet simulate under `physical`; two of the first six suffice."""


def platform(device: Device | None = None) -> dict[str, str]:
    """Versions, the number of the evaluation, and the digests of the probes' results.

    Entries of an engine concern its rows alone: `pybullet` and `probes`, which are absent where PyBullet is
    not installed; `mujoco` and `mujoco_probes`; and those of a device (`device_platform`). Probes of engines
    that `ENGINES_VARIABLE` leaves out are not evaluated.
    """
    found, served = base_platform(), os.environ.get(ENGINES_VARIABLE)
    if has_bullet() and (served is None or DEFAULT_ENGINE in served):
        found |= {"pybullet": version("pybullet"), "probes": probe_digest()}
    if served != DEFAULT_ENGINE:
        mujoco: str = import_module("mujoco").__version__
        found |= {"mujoco": mujoco, "mujoco_probes": physical_probe_digest("mujoco")}
    return found | (device_platform(device) if device else {})


def base_platform() -> dict[str, str]:
    """Entries of every platform: versions, machine, and the number of the evaluation."""
    found = {name: version(name) for name in ("qdgrasp", "numpy", "scipy")}
    return found | {"machine": machine.machine(), "evaluation": str(EVALUATION)}


def device_platform(device: Device) -> dict[str, str]:
    """Versions of warp and MuJoCo Warp, and the device's name.

    An InputError if there is no such device; a QdgraspError if it does not evaluate as MuJoCo does.
    """
    entries: dict[str, str] = import_module(DEVICE_MODULE).device_entries(device)
    trials, outcomes = np.zeros(PROBES, dtype=np.uint16), []
    for engine in ("mujoco", DEVICE_ENGINE):
        evaluator = make_evaluator(probe_scene("physical", engine), device)
        outcomes.append(evaluator.evaluate("approach", probes(), trials).rows["outcome"])
    if (same := int((outcomes[0] == outcomes[1]).sum())) < LEAST_AGREEING:
        raise QdgraspError(
            f"On the device {device.name} only {same} of {PROBES} probes of {DEVICE_ENGINE} have the outcome "
            f"that they have in mujoco, and {LEAST_AGREEING} must; it is not used."
        )
    return entries


def probe_digest() -> str:
    """sha256 over the result bytes of the probes, nominal and disturbed; some reach the shakes.

    Their rows are without columns of contacts.
    """
    scene = msgspec.structs.replace(probe_scene("robust"), contact_slots=0)
    return result_digest(scene, np.tile(probes(), (2, 1)), np.repeat([0, 1], PROBES))


def physical_probe_digest(engine: str) -> str:
    """sha256 over the result bytes of probes under `physical` in an engine; some grasps hold.

    All are simulated: the filters take longer to build than the simulation.
    """
    genomes = probes()[PHYSICAL_PROBES]
    return result_digest(
        probe_scene("physical", engine), genomes, np.zeros(len(genomes), dtype=int), shortcuts=False
    )


def result_digest(
    scene: Scene, genomes: NDArray[np.float32], trials: NDArray[np.int_], *, shortcuts: bool = True
) -> str:
    """sha256 over the result bytes of genomes (n, 7) of the prior approach in their trials (n,)."""
    with Evaluator(scene, shortcuts=shortcuts) as evaluator:
        rows = evaluator.evaluate("approach", genomes, trials.astype(np.uint16)).rows
    return hashlib.sha256(b"".join(pack(rows, RESULT).values())).hexdigest()


def probe_scene(protocol: str, engine: str | None = None) -> Scene:
    """The built-in Panda over the built-in tennis ball."""
    values = {"gripper": "panda", "object": "tennis_ball", "protocol": protocol, "engine": engine}
    return build_scene(msgspec.convert(values, RunSpec))


def probes() -> NDArray[np.float32]:
    """The genomes (16, 7) of the probes, of the prior approach."""
    genomes = np.random.default_rng(0).uniform(-1.0, 1.0, (PROBES, 7)).astype(np.float32)
    genomes[:PROBE_GRASPS, 3:5] = PROBE_AIM
    return genomes
