"""Evaluations per CPU second by hand, object and regime, beside the naive path, and what they are spent on.

Poses anywhere, poses near grasps (as `qdgrasp bench` draws them), and those of the default method's search.
"""

from collections.abc import Iterator
from contextlib import closing
from typing import NamedTuple

from tests.benchmarks.lot import Lot
from tests.benchmarks.measure import Figure
from tests.benchmarks.naive import Naive

from qdgrasp_assets.catalog import build_scene, gripper_names, object_names
from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.bench.regimes import PRIOR, Regime, Regimes
from qdgrasp_coordinator.preparation import full_spec
from qdgrasp_coordinator.search import method
from qdgrasp_coordinator.space import space
from qdgrasp_protocol.spec import DEFAULT_METHOD, RunSpec
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.service import SLICE

WARM = 200
"""Genomes of the search before it is measured: by then it has found its first grasps."""


class Pair(NamedTuple):
    """A hand and an object, and what else is measured of them."""

    hand: str
    object: str
    protocol: str = "paper"
    searched: bool = True
    """Whether the default method is measured, too."""


BUILT_IN = [
    Pair("panda", "rubiks_cube"),
    Pair("panda", "mug"),
    Pair("barrett", "rubiks_cube"),
    Pair("allegro", "rubiks_cube"),
    Pair("allegro", "mug"),
    Pair("shadow", "rubiks_cube"),
    Pair("robotiq_2f", "mug"),
]
REFERENCE = [
    Pair("ref_panda_2f", "ycb_rubiks_cube", "released", searched=False),
    Pair("ref_panda_2f", "ycb_mug", "released", searched=False),
    Pair("ref_bh280", "ycb_rubiks_cube", "released", searched=False),
    Pair("ref_allegro", "ycb_rubiks_cube", "released", searched=False),
    Pair("ref_shadow", "ycb_mug", "released", searched=False),
]


def measure(seconds: float) -> Iterator[Figure]:
    hands, things = gripper_names(), object_names()
    for pair in BUILT_IN + REFERENCE:
        if pair.hand in hands and pair.object in things:
            yield from _pair(pair, seconds)


def _pair(pair: Pair, seconds: float) -> Iterator[Figure]:
    scene = build_scene(RunSpec(gripper=pair.hand, object=pair.object, protocol=pair.protocol))
    regimes, name = Regimes(layout(scene, PRIOR)), f"{pair.hand} on {pair.object}"
    with Evaluator(scene) as evaluator, closing(Naive(scene)) as naive:
        looking = Lot(name, regimes, PRIOR, evaluator)
        while not regimes.has_looked:
            looking.skip(SLICE)
        for regime in (Regime.ANYWHERE, Regime.NEAR):
            regimes.turn(regime, SLICE)
            lot = Lot(f"{name}, {regime.value}", regimes, PRIOR, evaluator, naive, regimes.since)
            yield lot.measured(seconds)
        if pair.searched:
            yield _searched(pair, evaluator).skip(WARM).measured(seconds / 2)


def _searched(pair: Pair, evaluator: Evaluator) -> Lot:
    spec = full_spec({"gripper": pair.hand, "object": pair.object, "method": DEFAULT_METHOD})
    chosen, name = method(spec.method), f"{pair.hand} on {pair.object}, {spec.method}"
    return Lot(name, chosen.build(spec, space(evaluator.scene, chosen.prior)), chosen.prior, evaluator)
