"""The platform: all that decides the bits of results besides scene and genome."""

import hashlib
import platform as machine
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import qdgrasp_assets.genes
import qdgrasp_assets.geometry.mesh
import qdgrasp_assets.geometry.primitives
import qdgrasp_assets.geometry.rotation
import qdgrasp_assets.grippers.collision_shapes
import qdgrasp_assets.grippers.urdf
import qdgrasp_assets.scene
import qdgrasp_protocol.rows
from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import RESULT, pack
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator

NOT_EVALUATING = frozenset({"cli", "platform", "replay", "runtime"})
"""Modules and folders of this room that take no part in an evaluation's result."""
CONTRACTS = (
    qdgrasp_assets.genes,
    qdgrasp_assets.grippers.collision_shapes,
    qdgrasp_assets.geometry.mesh,
    qdgrasp_assets.geometry.primitives,
    qdgrasp_assets.geometry.rotation,
    qdgrasp_assets.scene,
    qdgrasp_assets.grippers.urdf,
    qdgrasp_protocol.rows,
)
"""Modules of other rooms that an evaluation reads its input by and writes its result by."""
PROBES = 16
PROBE_GRASPS = 6
PROBE_AIM = (-1.0, -0.5)
"""Genes nu and d of the first probes: straight above, so near that they reach the shakes."""


def platform() -> dict[str, str]:
    """Versions, the digest of the evaluation's code, and the digest of the probes' results."""
    return {
        "qdgrasp": version("qdgrasp"),
        "pybullet": version("pybullet"),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "machine": machine.machine(),
        "code": code_digest(),
        "probes": probe_digest(),
    }


def code_digest() -> str:
    """sha256 over the sources of everything that takes part in an evaluation."""
    here = Path(__file__).parent
    sources = [
        path
        for path in here.rglob("*.py")
        if NOT_EVALUATING.isdisjoint(path.relative_to(here).with_suffix("").parts)
    ]
    contracts = [Path(str(module.__file__)) for module in CONTRACTS]
    digest = hashlib.sha256()
    for path in [*sorted(sources), *contracts]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def probe_digest() -> str:
    """sha256 over the result bytes of the probes, nominal and disturbed; some reach the shakes."""
    genomes, trials = np.tile(probes(), (2, 1)), np.repeat(np.array([0, 1], dtype=np.uint16), PROBES)
    with Evaluator(probe_scene()) as evaluator:
        rows = evaluator.evaluate("approach", genomes, trials).rows
    return hashlib.sha256(b"".join(pack(rows, RESULT).values())).hexdigest()


def probe_scene() -> Scene:
    """The built-in Panda over the built-in tennis ball."""
    return build_scene(RunSpec(gripper="panda", object="tennis_ball", protocol="robust"))


def probes() -> NDArray[np.float32]:
    """The genomes (16, 7) of the probes, of the prior approach."""
    genomes = np.random.default_rng(0).uniform(-1.0, 1.0, (PROBES, 7)).astype(np.float32)
    genomes[:PROBE_GRASPS, 3:5] = PROBE_AIM
    return genomes
