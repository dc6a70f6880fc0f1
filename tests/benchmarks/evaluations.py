"""Evaluations per CPU second by hand, object and regime, beside the public code, and what they spend it on.

Poses anywhere, poses near grasps (as `qdgrasp bench` draws them), and those of the default method's search.
Those calls have the same genomes and the published model of the hand.
"""

from collections.abc import Iterator
from contextlib import closing
from typing import NamedTuple

from tests.benchmarks.hands import HANDS
from tests.benchmarks.lot import Lot
from tests.benchmarks.measure import Figure
from tests.benchmarks.naive import Published

from qdgrasp_assets.catalog import build_scene, gripper_names, object_names
from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.bench.regimes import PRIOR, Regime, Regimes
from qdgrasp_coordinator.runs.preparation import full_spec
from qdgrasp_coordinator.searches.search import method
from qdgrasp_coordinator.searches.space import space
from qdgrasp_protocol.spec import DEFAULT_METHOD, RunSpec
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.serving.child import SLICE

WARM = 200
"""Genomes of the search before it is measured: by then it has found its first grasps."""


TURNS = {Regime.ANYWHERE: 2.0, Regime.NEAR: 1.0}
"""How much longer poses anywhere are measured: few of them take most of the time."""


class Pair(NamedTuple):
    """A hand and an object, and what else is measured of them."""

    hand: str
    object: str
    protocol: str = "paper"
    searched: bool = True
    """Whether the default method is measured, too."""

    @property
    def published(self) -> str:
        """The hand of the public code: the published model, where it is there."""
        hand = HANDS.get(self.hand, self.hand)
        return hand if hand in gripper_names() else self.hand


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
    scene, theirs = (
        build_scene(RunSpec(gripper=hand, object=pair.object, protocol=pair.protocol))
        for hand in (pair.hand, pair.published)
    )
    regimes, name = Regimes(layout(scene, PRIOR)), f"{pair.hand} on {pair.object}"
    with Evaluator(scene) as evaluator, closing(Published(theirs)) as naive:
        looking = Lot(name, regimes, PRIOR, evaluator)
        while not regimes.has_looked:
            looking.skip(SLICE)
        for regime in (Regime.ANYWHERE, Regime.NEAR):
            regimes.turn(regime, SLICE)
            lot = Lot(f"{name}, {regime.value}", regimes, PRIOR, evaluator, naive, regimes.since)
            yield lot.measured(seconds * TURNS[regime])
        if pair.searched:
            yield _searched(pair, evaluator).skip(WARM).measured(seconds / 2)


def _searched(pair: Pair, evaluator: Evaluator) -> Lot:
    spec = full_spec({"gripper": pair.hand, "object": pair.object, "method": DEFAULT_METHOD})
    chosen, name = method(spec.method), f"{pair.hand} on {pair.object}, {spec.method}"
    return Lot(name, chosen.build(spec, space(evaluator.scene, chosen.prior)), chosen.prior, evaluator)
