"""Built-in hands beside the reference hands on the same genomes: `python -m benchmarks.hands`.

Protocol `paper`. Each hand is judged on genomes of the prior `contact` anywhere, and on others around those
that succeeded with one hand or the other. The reference hand is judged again with every pose moved by 1 um:
no model can agree better with it than it does with itself.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from benchmarks.measure import Meter, machine
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.catalog import build_scene, gripper_names, object_names
from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.evaluator import Evaluator

HANDS = {
    "panda": "ref_panda_2f",
    "barrett": "ref_bh280",
    "allegro": "ref_allegro",
    "shadow": "ref_shadow",
    "robotiq_2f": "ref_robotiq_2f",
}
OBJECTS = ("ycb_rubiks_cube", "ycb_mug", "ycb_banana")
PRIOR, POSE_GENES = "contact", 7
BATCH = 50
"""Genomes until it is the other hand's turn."""
PARENTS = 20
"""Successes that are looked for on each object."""
MOST = 8
"""Times that genomes are drawn anywhere, at most."""
SIGMA = 0.05
"""Deviation of the genes around those of successes: some 9 degrees, and 2 to 5 mm."""
MOVED = 1e-6  # m


Found = dict[str, dict[str, Any]]
"""The figures of each hand."""


@dataclass(frozen=True)
class Verdicts:
    """Results of one hand for some genomes, and their cost."""

    outcome: NDArray[np.uint8]
    fitness: NDArray[np.float32]
    base_to_object: NDArray[np.float32]
    steps: int
    seconds: float

    @property
    def is_success(self) -> NDArray[np.bool_]:
        return self.outcome >= Outcome.DROPPED

    @property
    def is_miss(self) -> NDArray[np.bool_]:
        """Which genomes were simulated without success."""
        return (self.outcome >= Outcome.MISSED) & ~self.is_success

    @property
    def cost(self) -> dict[str, float]:
        n = len(self.outcome)
        return {"evaluations": n, "steps": self.steps / n, "cpu_ms": 1e3 * self.seconds / n}


def joined(parts: Sequence[Verdicts]) -> Verdicts:
    columns = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("outcome", "fitness", "base_to_object")
    )
    return Verdicts(*columns, sum(part.steps for part in parts), sum(part.seconds for part in parts))


VerdictTriple = tuple[Verdicts, Verdicts, Verdicts]
"""Verdicts of the built-in hand, the reference hand, and that one on poses moved by 1 um."""


def _joined(parts: Sequence[VerdictTriple]) -> VerdictTriple:
    own, reference, again = (joined(side) for side in zip(*parts, strict=True))
    return own, reference, again


@dataclass(frozen=True)
class Comparison:
    """Figures of a built-in hand, from genomes anywhere and near successes."""

    anywhere: VerdictTriple
    near: VerdictTriple

    def as_dict(self) -> dict[str, Any]:
        own, reference, again = _joined([self.anywhere, self.near])
        chosen = balanced(reference)
        return {
            "balanced": {
                "poses": len(chosen),
                "built_in": agreement(own.is_success, reference.is_success, chosen),
                "itself": agreement(again.is_success, reference.is_success, chosen),
            },
            "fitness": {"built_in": on_grasps(own, reference), "itself": on_grasps(again, reference)},
            "cost": {
                place: {
                    side: verdicts.cost
                    for side, verdicts in zip(("built_in", "reference"), sides[:2], strict=True)
                }
                for place, sides in (("anywhere", self.anywhere), ("near", self.near))
            },
        }


def agreement(ours: NDArray[np.generic], theirs: NDArray[np.generic], where: NDArray[np.generic]) -> float:
    return float((ours == theirs)[where].mean())


def on_grasps(ours: Verdicts, theirs: Verdicts) -> dict[str, float]:
    """Agreement on fitness where either hand survives a shake."""
    either = (ours.fitness >= 1) | (theirs.fitness >= 1)
    return {"poses": int(either.sum()), "share": agreement(ours.fitness, theirs.fitness, either)}


def balanced(verdicts: Verdicts) -> NDArray[np.intp]:
    """Return the places of as many successes as misses."""
    hits, misses = np.flatnonzero(verdicts.is_success), np.flatnonzero(verdicts.is_miss)
    random, count = np.random.default_rng(0), min(len(hits), len(misses))
    return np.concatenate([random.choice(each, count, replace=False) for each in (hits, misses)])


def compare(hand: str, objects: Sequence[str], number: int) -> Comparison:
    """Both hands on every object, with so many genomes on each."""
    parts = [_on(hand, thing, number) for thing in objects]
    return Comparison(_joined([part.anywhere for part in parts]), _joined([part.near for part in parts]))


def _on(hand: str, thing: str, number: int) -> Comparison:
    random = np.random.default_rng(0)
    with _evaluator(hand, thing) as own, _evaluator(HANDS[hand], thing) as reference:
        genes = len(layout(reference.scene, PRIOR))
        genomes, anywhere = np.zeros((0, genes), np.float32), []
        for _ in range(MOST):
            drawn = random.uniform(-1, 1, (number, genes)).astype(np.float32)
            genomes = np.concatenate([genomes, drawn])
            anywhere.append(_evaluate_both(own, reference, drawn, random))
            succeeded = np.concatenate([ours.is_success | theirs.is_success for ours, theirs, _ in anywhere])
            if succeeded.sum() >= PARENTS:
                break
        near = _evaluate_both(own, reference, _around(genomes[succeeded], number, random), random)
    return Comparison(_joined(anywhere), near)


def _evaluator(gripper: str, thing: str) -> Evaluator:
    return Evaluator(build_scene(RunSpec(gripper=gripper, object=thing)))


def _around(parents: NDArray[np.float32], number: int, random: np.random.Generator) -> NDArray[np.float32]:
    chosen = parents[random.integers(len(parents), size=number)]
    return np.clip(chosen + random.normal(0, SIGMA, chosen.shape), -1, 1).astype(np.float32)


def _evaluate_both(
    own: Evaluator, reference: Evaluator, genomes: NDArray[np.float32], random: np.random.Generator
) -> VerdictTriple:
    ours, theirs = _alternately([own, reference], PRIOR, genomes)
    np.testing.assert_array_equal(ours.base_to_object, theirs.base_to_object)
    shift = random.normal(size=(len(genomes), 3))
    shift *= MOVED / np.linalg.norm(shift, axis=1, keepdims=True)
    poses = _given_genomes(reference, genomes, theirs.base_to_object)
    poses[:, :3] += shift.astype(np.float32)
    return ours, theirs, _alternately([reference], "given", poses)[0]


def _given_genomes(
    evaluator: Evaluator, genomes: NDArray[np.float32], base_to_object: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The poses of genomes as genomes of the prior `given`: with the synergy's label and the free joints."""
    genes = layout(evaluator.scene, PRIOR)
    more = genes.values(genomes)[:, POSE_GENES:]
    labels = [place for place, name in enumerate(genes.names[POSE_GENES:]) if name == "synergy"]
    more[:, labels] = np.rint(more[:, labels])
    return np.concatenate([base_to_object, more], axis=1).astype(np.float32)


def _alternately(evaluators: Sequence[Evaluator], prior: str, genomes: NDArray[np.float32]) -> list[Verdicts]:
    """The verdicts of each evaluator, which take turns batch by batch."""
    parts: list[list[Verdicts]] = [[] for _ in evaluators]
    for start in range(0, len(genomes), BATCH):
        for evaluator, done in zip(evaluators, parts, strict=True):
            done.append(_measured(evaluator, prior, genomes[start : start + BATCH]))
    return [joined(done) for done in parts]


def _measured(evaluator: Evaluator, prior: str, genomes: NDArray[np.float32]) -> Verdicts:
    meter = Meter()
    with counted_steps() as steps, meter.running():
        evaluation = evaluator.evaluate(prior, genomes, np.zeros(len(genomes), np.uint16))
    rows: Rows = evaluation.rows
    columns = (rows[name] for name in ("outcome", "fitness", "base_to_object"))
    return Verdicts(*columns, len(steps), meter.seconds)


@contextmanager
def counted_steps() -> Iterator[list[None]]:
    """Count the steps of the simulator in this block: the list gets an item for each."""
    steps: list[None] = []
    step = BulletShakenWorld.step

    def counted(world: BulletShakenWorld) -> None:
        steps.append(None)
        step(world)

    with patch.object(BulletShakenWorld, "step", counted):
        yield steps


def agreements(found: Found) -> Table:
    shown = Table(
        "hand", "poses", "success", "the reference itself", "grasps", "fitness", "the reference itself"
    )
    shown.title = "agreement with the reference hand"
    for hand, figures in found.items():
        even, fitness = figures["balanced"], figures["fitness"]
        success = (_percent(even[side]) for side in ("built_in", "itself"))
        shares = (_percent(fitness[side]["share"]) for side in ("built_in", "itself"))
        shown.add_row(hand, str(even["poses"]), *success, str(fitness["built_in"]["poses"]), *shares)
    return shown


def costs(found: Found) -> Table:
    shown = Table("hand", "genomes", "evaluations", "steps", "steps, ref.", "CPU ms", "CPU ms, ref.", "ratio")
    shown.title = "an evaluation, built-in and reference"
    for hand, figures in found.items():
        for place, sides in figures["cost"].items():
            own, reference = sides["built_in"], sides["reference"]
            steps = (f"{side['steps']:.0f}" for side in (own, reference))
            cpu = (f"{side['cpu_ms']:.2f}" for side in (own, reference))
            ratio = f"{own['cpu_ms'] / reference['cpu_ms']:.2f}"
            shown.add_row(hand, place, str(own["evaluations"]), *steps, *cpu, ratio)
    return shown


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hands", description=__doc__)
    parser.add_argument("--hands", nargs="+", choices=HANDS, default=list(HANDS))
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--number", type=int, default=250, help="genomes anywhere, and near, on each object")
    asked = parser.parse_args()
    absent = [name for name in asked.objects if name not in object_names()]
    absent += [HANDS[hand] for hand in asked.hands if HANDS[hand] not in gripper_names()]
    for name in absent:
        sys.stderr.write(f"{name} is absent (`qdgrasp asset list`); what needs it is left out.\n")
    objects = [name for name in asked.objects if name not in absent]
    hands = [hand for hand in asked.hands if HANDS[hand] not in absent and objects]
    found = {hand: compare(hand, objects, asked.number).as_dict() for hand in hands}
    Console(stderr=True, width=120).print(agreements(found), costs(found))
    values = {"machine": machine(), "objects": objects, "number": asked.number, "hands": found}
    sys.stdout.write(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
