"""Effect of convex parts on verdicts, and the cost of an evaluation with them.

`python -m benchmarks.parts [OBJECT ...] [--thresholds T ...]`. The stand-ins are made of convex parts that
enclose the same space as their surface: they show what is lost when CoACD cuts that surface into parts, and
the effect of the rule of `qdgrasp_assets.geometry.collision_parts`
(docs/decisions/0008-collision-decomposition.md). Scans are held against the hulls of the reference data.
Contacts are chaotic: the finest threshold shows how much is chance.
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from benchmarks.measure import machine
from msgspec.structs import replace
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.catalog import build_scene, find_object
from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.collision_parts import FingerClearance, decompose
from qdgrasp_assets.geometry.mesh import Mesh, parts_to_obj
from qdgrasp_assets.geometry.primitives import hull
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator

OBJECTS = ("mug", "bowl", "power_drill", "spatula")
THRESHOLDS = (0.1, 0.05, 0.025)
GRIPPER, PRIOR = "panda", "contact"
SIGMA = 0.03
"""Deviation of each gene around that of a grasp."""
BATCH = 64
TIME_LIMIT = 600.0  # s
OWN, HULL = "own", "hull"
Genomes = NDArray[np.float32]


@dataclass(frozen=True)
class Verdicts:
    """Results of genomes with an object's parts."""

    rows: Rows
    seconds: float
    """CPU time."""

    @property
    def grasps(self) -> NDArray[np.bool_]:
        return np.asarray(self.rows["fitness"] >= 1)

    @property
    def each(self) -> float:
        """CPU microseconds of an evaluation."""
        return 1e6 * self.seconds / len(self.rows)


@dataclass(frozen=True)
class Line:
    """One set of parts, compared with the right ones."""

    object: str
    parts_from: str
    parts: int
    corners: int
    filled: float
    bare: float
    fits: bool
    decomposed_in: float
    """Wall-clock seconds."""
    outcomes_agree: float
    """Share of random poses with the same outcome."""
    lost: float
    """Share of the grasps near grasps that these parts lose."""
    gained: float
    fitness_agrees: float
    """Share of equal fitness where either set has a grasp."""
    random_us: float
    near_us: float


class PartsComparison:
    """One object under several sets of parts."""

    def __init__(self, name: str, number: int, near: int) -> None:
        self.name = name
        spec = RunSpec(gripper=GRIPPER, object=name, mass=0.1 if "." in name else None)
        self._scene = build_scene(spec)
        target = find_object(spec)
        self.mesh, self.own = target.centred_mesh, target.centred_parts
        self._clearance = FingerClearance(self.mesh)
        genes = len(layout(self._scene, PRIOR))
        random = np.random.default_rng(0)
        self._anywhere = random.uniform(-1.0, 1.0, (number, genes)).astype(np.float32)
        with Evaluator(self._scene) as evaluator:
            self._right_anywhere = evaluated(evaluator, self._anywhere)
            grasps = self._anywhere[self._right_anywhere.grasps]
            around = grasps[random.integers(len(grasps), size=near)]
            moved = around + random.normal(0.0, SIGMA, around.shape)
            self._near = np.clip(moved, -1.0, 1.0).astype(np.float32)
            self._right_near = evaluated(evaluator, self._near)

    def line(self, source: str, parts: tuple[Mesh, ...], seconds: float) -> Line:
        """The line of these parts, on the same poses."""
        anywhere, near = self._right_anywhere, self._right_near
        if source != OWN:
            with Evaluator(with_parts(self._scene, parts)) as evaluator:
                anywhere, near = evaluated(evaluator, self._anywhere), evaluated(evaluator, self._near)
        right, either = self._right_near.grasps, self._right_near.grasps | near.grasps
        agrees = self._right_near.rows["fitness"] == near.rows["fitness"]
        same = self._right_anywhere.rows["outcome"] == anywhere.rows["outcome"]
        fit = self._clearance.fit(parts)
        return Line(
            object=self.name,
            parts_from=source,
            parts=len(parts),
            corners=sum(len(part.vertices) for part in parts),
            filled=fit.filled,
            bare=fit.bare,
            fits=fit.is_good,
            decomposed_in=seconds,
            outcomes_agree=float(same.mean()),
            lost=float((right & ~near.grasps).sum() / right.sum()),
            gained=float((~right & near.grasps).sum() / right.sum()),
            fitness_agrees=float(agrees[either].mean()),
            random_us=anywhere.each,
            near_us=near.each,
        )


def evaluated(evaluator: Evaluator, genomes: Genomes) -> Verdicts:
    """The rows of genomes, and their cost."""
    evaluator.evaluate(PRIOR, genomes[:1], np.zeros(1, np.uint16))  # setup is not measured
    began = time.process_time()
    rows = [
        evaluator.evaluate(PRIOR, some, np.zeros(len(some), np.uint16)).rows
        for some in (genomes[start : start + BATCH] for start in range(0, len(genomes), BATCH))
    ]
    return Verdicts(np.concatenate(rows), time.process_time() - began)


def with_parts(scene: Scene, parts: tuple[Mesh, ...]) -> Scene:
    """The scene with other collision parts, CoM frame."""
    return replace(scene, object=replace(scene.object, collision=parts_to_obj(parts)))


def compare(name: str, thresholds: tuple[float, ...], number: int, near: int) -> list[Line]:
    """Its own parts, the hull, and the parts that CoACD finds at each threshold."""
    comparison = PartsComparison(name, number, near)
    sets: Mapping[str, float | None] = {OWN: None, HULL: None, **{f"{each:g}": each for each in thresholds}}
    lines = []
    for source, threshold in sets.items():
        began = time.perf_counter()
        parts = parts_of(comparison, source, threshold)
        lines.append(comparison.line(source, parts, time.perf_counter() - began))
    return lines


def parts_of(comparison: PartsComparison, source: str, threshold: float | None) -> tuple[Mesh, ...]:
    """One of the sets of parts."""
    if threshold is not None:
        return decompose(comparison.mesh, comparison.name, threshold, TIME_LIMIT)
    return comparison.own if source == OWN else (hull(comparison.mesh.vertices),)


def table(lines: list[Line]) -> Table:
    shown = Table(
        "object", "parts from", "parts", "corners", "filled", "fits", "decomposed in", "same outcome, random",
        "grasps lost", "gained", "same fitness", "us, random", "us, near", title="convex parts",
    )  # fmt: skip
    for line in lines:
        shares = (line.outcomes_agree, line.lost, line.gained, line.fitness_agrees)
        percent = [f"{100 * share:.1f} %" for share in shares]
        shown.add_row(
            line.object, line.parts_from, str(line.parts), str(line.corners), f"{100 * line.filled:.1f} %",
            "yes" if line.fits else "no", f"{line.decomposed_in:.0f} s", *percent,
            f"{line.random_us:,.0f}", f"{line.near_us:,.0f}",
        )  # fmt: skip
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.parts", description=__doc__)
    parser.add_argument("objects", nargs="*", default=OBJECTS, metavar="OBJECT")
    parser.add_argument("--thresholds", nargs="+", type=float, default=THRESHOLDS)
    parser.add_argument("--number", type=int, default=4000, help="random poses on each object")
    parser.add_argument("--near", type=int, default=250, help="poses near grasps among them")
    asked = parser.parse_args()
    lines = [
        line
        for name in asked.objects
        for line in compare(name, tuple(asked.thresholds), asked.number, asked.near)
    ]
    Console(stderr=True, width=170).print(table(lines))
    values = {"machine": machine(), "lines": [asdict(line) for line in lines]}
    sys.stdout.write(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
