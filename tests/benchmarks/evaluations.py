"""Evaluations per CPU second: poses anywhere, and poses close to successes."""

import numpy as np
from numpy.typing import NDArray
from tests.benchmarks.measure import Figure, Meter

from qdgrasp_assets.catalog import build_scene, object_names
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluate import Evaluator

BATCH = 64
NEAR = 0.02
"""Sigma of the genes around those of successes."""
SEARCHED = 40
"""Batches in which successes are looked for."""
PAIRS = [
    ("panda", "rubiks_cube"),
    ("panda", "mug"),
    ("ref_panda_2f", "ycb_rubiks_cube"),
    ("ref_panda_2f", "ycb_mug"),
]


def measure(seconds: float) -> list[Figure]:
    here = object_names()
    return [figure for hand, thing in PAIRS if thing in here for figure in _pair(hand, thing, seconds)]


def _pair(hand: str, thing: str, seconds: float) -> list[Figure]:
    scene = build_scene(RunSpec(gripper=hand, object=thing))
    random = np.random.default_rng(0)
    with Evaluator(scene) as evaluator:
        evaluator.evaluate("contact", _uniform(random, scene, "contact"), np.zeros(BATCH, np.uint16))
        anywhere = _measured(evaluator, "contact", random, None, seconds)
        known = _successes(evaluator, scene, random)
        near = _measured(evaluator, "approach", random, known, seconds)
    name = f"{hand} on {thing}"
    return [Figure(f"{name}, anywhere", *anywhere), Figure(f"{name}, near successes", *near)]


def _measured(
    evaluator: Evaluator,
    prior: str,
    random: np.random.Generator,
    known: NDArray[np.float32] | None,
    seconds: float,
) -> tuple[int, float, str, str]:
    meter, found = Meter(), []
    while meter.seconds < seconds:
        genomes = _uniform(random, evaluator.scene, prior) if known is None else _around(random, known)
        with meter.running():
            found.append(evaluator.evaluate(prior, genomes, np.zeros(BATCH, np.uint16)).rows)
    rows = np.concatenate(found)
    return len(rows), meter.seconds, "cpu", _shares(rows)


def _shares(rows: Rows) -> str:
    overlaps, successes = (
        (rows["outcome"] == Outcome.OVERLAP).mean(),
        (rows["outcome"] >= Outcome.DROPPED).mean(),
    )
    return f"{100 * overlaps:.0f} % overlaps, {100 * successes:.0f} % successes"


def _successes(evaluator: Evaluator, scene: Scene, random: np.random.Generator) -> NDArray[np.float32]:
    trials = np.zeros(BATCH, np.uint16)
    tried = [
        evaluator.evaluate("approach", _uniform(random, scene, "approach"), trials).rows
        for _ in range(SEARCHED)
    ]
    rows = np.concatenate(tried)
    genomes: NDArray[np.float32] = rows["genome"][rows["outcome"] >= Outcome.DROPPED]
    return genomes


def _uniform(random: np.random.Generator, scene: Scene, prior: str) -> NDArray[np.float32]:
    return random.uniform(-1, 1, (BATCH, len(layout(scene, prior)))).astype(np.float32)


def _around(random: np.random.Generator, known: NDArray[np.float32]) -> NDArray[np.float32]:
    parents = known[random.integers(len(known), size=BATCH)]
    return np.clip(parents + random.normal(0, NEAR, parents.shape), -1, 1).astype(np.float32)
