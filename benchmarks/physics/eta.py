"""Does eta under `robust` on `physical` tell grasps apart? `python -m benchmarks.physics.eta --help`.

Grasps that hold are taken in groups of one block of 2 cm, of a run under `physical` (Panda, `aimed`, seed 0);
those that do not hold are a dozen of each outcome. They meet trials in which the hand is set at its pose
("set"), goes back from it to the first clear place ("retreat"), or comes from outside and stops before it
would be inside the object ("path", that of the protocol), and the trials of `robust` on `paper`. Results
are stored in a folder, and are not simulated again.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.single_run import run
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.rotation import from_euler, multiply
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_worker.decoder import Decoder, HandPose
from qdgrasp_worker.episode import APPROACH_STEP, approach_path
from qdgrasp_worker.evaluation_protocols import TrialSetup, scene_protocol
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.physical_episode import PhysicalEpisode, PhysicalWorld

HAND = "panda"
EVALUATIONS = {"ycb_rubiks_cube": 800, "ycb_mug": 800, "ycb_power_drill": 600}
HELD, OTHERS = 60, 12  # Number of grasps that hold, and of each other outcome of a success
BLOCK, LEAST, MOST = 0.02, 3, 5  # Side of the block of a group [m], and grasps taken from it
TRIALS = 50
ARRIVALS = ("set", "retreat", "path")
ARMS = ("paper", *ARRIVALS)
PUSHES, SHAKES = 6, 2
STRENGTHS = (0, 2, 5, 10, 20, 40)
FEW = 10  # Trials that smoothing begins from
MOVES, SIGMA, ANGLE = 8, 3e-3, np.radians(3.0)  # Half of them with half the sigmas [m, rad]
FIRST, SECOND, BEST = range(1, 11), range(11, 41), 2  # Trials of all moves, then of the best
FRESH = range(51, 101)
Arrays = dict[str, NDArray[Any]]


def cached_arrays(file: Path, make: Callable[[], Arrays]) -> Arrays:
    """The arrays in an npz file, made where there is none."""
    if not file.exists():
        np.savez(file.with_suffix(".part.npz"), allow_pickle=False, **make())
        file.with_suffix(".part.npz").rename(file)
    with np.load(file) as arrays:
        return dict(arrays)


@dataclass(frozen=True)
class Results:
    """Results of trials (n, t) of grasps."""

    outcome: NDArray[np.int64]
    fitness: NDArray[np.int64]

    def eta(self, disturbances: int, first: int = 0, last: int = TRIALS) -> NDArray[np.float64]:
        """The share (n,) of disturbances survived in the trials of these places."""
        means: NDArray[np.float64] = self.fitness[:, first:last].mean(axis=1) / disturbances
        return means


class Study:
    """The grasps of one object and the results of their trials, stored in a folder."""

    def __init__(self, target: str, folder: Path) -> None:
        self.target = target
        self._folder = folder

    def scene(self, base: str) -> Scene:
        """The scene of `robust` on a base."""
        return build_scene(full_spec({**self._words, "protocol": "robust", "base": base}))

    @property
    def _words(self) -> dict[str, Any]:
        return {"gripper": HAND, "object": self.target, "evaluations": EVALUATIONS[self.target], "seed": 0}

    def _cached(self, name: str, make: Any) -> Arrays:
        """Arrays of a file, made where there is none."""
        return cached_arrays(self._folder / f"{self.target}-{name}.npz", make)

    @cached_property
    def grasps(self) -> Arrays:
        """The successes that are looked at: genomes, outcome, position, penetration, group (-1: none)."""
        return self._cached("grasps", self._choose)

    def _choose(self) -> Arrays:
        found = run(full_spec({**self._words, "protocol": "physical"}))
        rows = found.rows[found.rows["outcome"] >= Outcome.DROPPED]
        random, outcome, positions = np.random.default_rng(0), rows["outcome"], rows["base_to_object"][:, :3]
        blocks: dict[tuple[int, ...], list[int]] = {}
        for place in np.flatnonzero(outcome == Outcome.HELD):
            key = tuple(np.floor(positions[place] / BLOCK).astype(int).tolist())
            blocks.setdefault(key, []).append(int(place))
        full = [members[:MOST] for _, members in sorted(blocks.items()) if len(members) >= LEAST]
        chosen: list[int] = []
        groups: list[int] = []
        for number in random.permutation(len(full)).tolist():
            if len(chosen) + len(full[number]) <= HELD:
                chosen += full[number]
                groups += [number] * len(full[number])
        for other in (Outcome.DROPPED, Outcome.SHAKEN):
            places = random.permutation(np.flatnonzero(outcome == other))[:OTHERS].tolist()
            chosen, groups = chosen + places, groups + [-1] * len(places)
        return {
            "genomes": as_given(found.scene, prior_of(found.spec), rows[chosen]),
            "outcome": outcome[chosen],
            "position": positions[chosen],
            "penetration": rows["penetration"][chosen],
            "group": np.array(groups),
            "all": np.bincount(outcome, minlength=len(Outcome)),
        }

    @cached_property
    def _arrivals(self) -> Arrays:
        return self._cached("arrivals", lambda: met_trials(self.scene("physical"), self.grasps["genomes"]))

    @cached_property
    def _paper(self) -> Arrays:
        def make() -> Arrays:
            with Evaluator(self.scene("paper")) as evaluator:
                return evaluated(evaluator, self.grasps["genomes"], range(1, TRIALS + 1))

        return self._cached("paper", make)

    def results(self, arm: str) -> Results:
        """The trials of all grasps in an arm."""
        found = self._paper if arm == "paper" else self._arrivals
        prefix = "" if arm == "paper" else f"{arm} "
        return Results(*(found[prefix + name].astype(np.int64) for name in ("outcome", "fitness")))

    @property
    def seconds(self) -> NDArray[np.float64]:
        """CPU time of a trial on `paper`, of a way from outside, and of a trial of each arrival [s]."""
        return np.array([self._paper["seconds"], *self._arrivals["seconds"]])

    def refined(self, which: str) -> Arrays:
        """Fresh etas of the first or best grasp of each group, of its refined one and of its neighbour."""
        is_best = which == "best"
        return self._cached("refined-best" if is_best else "refined", lambda: refine(self, is_best=is_best))


def evaluated(evaluator: Evaluator, genomes: NDArray[np.float32], numbers: Iterable[int]) -> Arrays:
    """Trials of grasps: outcome and fitness (n, t), CPU seconds of one."""
    trials = np.array([*numbers], np.uint16)
    started = time.process_time()
    rows = [evaluator.evaluate(GIVEN, np.tile(genome, (len(trials), 1)), trials).rows for genome in genomes]
    seconds = (time.process_time() - started) / max(1, len(genomes) * len(trials))
    found = {name: np.array([each[name] for each in rows]) for name in ("outcome", "fitness")}
    return {**found, "seconds": np.array(seconds)}


def clear_places(
    world: PhysicalWorld, episode: PhysicalEpisode, trial: TrialSetup
) -> tuple[list[HandPose], list[bool]]:
    """The path of a trial, and where on it the hand is clear."""
    path = approach_path(trial.pose, world.approach_axis, world.reach)
    world.reset(replace(trial, pose=path[0]), trial.pose.joints)
    clear = []
    for pose in path:
        world.place_hand(pose)
        clear.append(not episode._is_inside())
    return path, clear


def met_trials(scene: Scene, genomes: NDArray[np.float32]) -> Arrays:
    """Trials of grasps after each arrival; where two arrive at one place it is simulated once."""
    shape = len(genomes), TRIALS
    found = {f"{arm} {name}": np.zeros(shape, int) for arm in ARRIVALS for name in ("outcome", "fitness")}
    back = {f"{arm} back": np.zeros(shape) for arm in ARRIVALS}
    protocol, poses = scene_protocol(scene), Decoder(scene, GIVEN, ObjectSurface(scene))(genomes)
    walking, simulating = 0.0, dict.fromkeys(ARRIVALS, 0.0)
    with closing(Evaluator(scene)) as evaluator:
        episode = PhysicalEpisode(evaluator._worlds[0], protocol, evaluator._contact_filter)
        for i, number in np.ndindex(shape):
            trial = protocol.trial(poses[i], number + 1)
            started = time.process_time()
            path, clear = clear_places(evaluator._worlds[0], episode, trial)
            walking += time.process_time() - started
            last = len(path) - 1
            first_blocked = clear.index(False) if False in clear else len(path)
            stops = {
                "set": last,
                "retreat": max((place for place in range(len(path)) if clear[place]), default=0),
                "path": max(first_blocked - 1, 0),
            }
            known: dict[int, tuple[Any, float]] = {}
            for arm, stop in stops.items():
                if stop not in known:
                    started = time.process_time()
                    result = episode.run(replace(trial, pose=path[stop], approaches=False))
                    known[stop] = result, time.process_time() - started
                result, seconds = known[stop]
                found[f"{arm} outcome"][i, number] = result.outcome
                found[f"{arm} fitness"][i, number] = result.fitness
                back[f"{arm} back"][i, number] = last - stop
                simulating[arm] += seconds
    costs = np.array([walking, *simulating.values()]) / max(1, len(genomes) * TRIALS)
    return {**found, **back, "seconds": costs}


def moved(genome: NDArray[np.float32], random: np.random.Generator) -> NDArray[np.float32]:
    """Small moves (m, g) of the pose in a genome (g,) of the prior `given`."""
    scale = np.where(np.arange(MOVES) % 2 == 0, 1.0, 0.5)[:, None]
    moves = np.tile(genome, (MOVES, 1)).astype(np.float64)
    moves[:, :3] += scale * random.normal(0.0, SIGMA, (MOVES, 3))
    moves[:, 3:7] = multiply(from_euler(scale * random.normal(0.0, ANGLE, (MOVES, 3))), moves[:, 3:7])
    return moves.astype(np.float32)


def refine(study: Study, *, is_best: bool) -> Arrays:
    """Fresh etas (groups, 3) of a grasp of each group, of its refined one, and of the group's best.

    It is the first, or the best by 40 trials.
    """
    grasps, known = study.grasps, study.results("path")
    early = known.eta(PUSHES, 0, SECOND.stop - 1)
    rows, seconds, simulated = [], [], []
    with Evaluator(study.scene("physical")) as evaluator:

        def etas(genomes: NDArray[np.float32], numbers: Sequence[int]) -> NDArray[np.float64]:
            means: NDArray[np.float64] = evaluated(evaluator, genomes, numbers)["fitness"].mean(axis=1)
            return means / PUSHES

        for group in sorted({*grasps["group"].tolist()} - {-1}):
            members = np.flatnonzero(grasps["group"] == group)
            own = members[early[members].argmax()] if is_best else members[0]
            started = time.process_time()
            moves = moved(grasps["genomes"][own], np.random.default_rng([1, group]))
            moves = moves[evaluated(evaluator, moves, [0])["outcome"][:, 0] == Outcome.HELD]
            chosen, best = grasps["genomes"][own], early[own]
            trials = 0
            if len(moves):
                first = etas(moves, FIRST)
                finals = np.argsort(-first, kind="stable")[:BEST]
                second = etas(moves[finals], SECOND)
                whole = (len(FIRST) * first[finals] + len(SECOND) * second) / (len(FIRST) + len(SECOND))
                trials = len(moves) * len(FIRST) + len(finals) * len(SECOND)
                if whole.max() > best:
                    chosen = moves[finals[whole.argmax()]]
            spent = time.process_time() - started
            others = np.union1d([own], members[: 1 + round(trials / TRIALS)])
            neighbour = others[known.eta(PUSHES)[others].argmax()]
            fresh = [grasps["genomes"][own], chosen, grasps["genomes"][neighbour]]
            distinct = {genome.tobytes(): genome for genome in fresh}
            found = dict(zip(distinct, etas(np.array([*distinct.values()]), FRESH), strict=True))
            rows.append([found[genome.tobytes()] for genome in fresh])
            seconds.append(spent)
            simulated.append([trials, TRIALS * (len(others) - 1)])
    return {"eta": np.array(rows), "seconds": np.array(seconds), "simulated": np.array(simulated)}


def mean_error(values: NDArray[np.float64]) -> str:
    """A mean and its standard error."""
    error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return f"{values.mean():.3f} ± {error:.3f}"


def ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks (n,), equal ones sharing theirs."""
    order = np.sort(values)
    return (np.searchsorted(order, values, "left") + np.searchsorted(order, values, "right")) / 2.0


def disturbances(arm: str) -> int:
    """Number of disturbances of a trial."""
    return SHAKES if arm == "paper" else PUSHES


def outcome_rows(study: Study) -> Iterable[list[object]]:
    """Shares of outcomes in trials of grasps that hold, etas by nominal outcome, agreement of halves."""
    nominal = study.grasps["outcome"]
    for arm in ARMS:
        found = study.results(arm)
        is_held = nominal == Outcome.HELD
        shares = np.bincount(found.outcome[is_held].ravel(), minlength=len(Outcome)) / is_held.sum() / TRIALS
        eta = found.eta(disturbances(arm))
        by_class = [eta[nominal == outcome] for outcome in (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)]
        halves = np.array([found.fitness[is_held, k::2].mean(axis=1) / disturbances(arm) for k in (0, 1)])
        spread = np.cov(halves)[0, 1]
        yield [
            study.target,
            arm,
            *(f"{share:.3f}" for share in shares[Outcome.OVERLAP :]),
            *(mean_error(each) if len(each) else "-" for each in by_class),
            f"{np.sqrt(max(spread, 0.0)):.3f}",
            f"{np.corrcoef(halves)[0, 1]:.2f}",
            f"{np.corrcoef([ranks(half) for half in halves])[0, 1]:.2f}",
        ]


def choice_rows(study: Study) -> Iterable[list[object]]:
    """Choices in groups by eta of trials 1 to 25, judged by trials 26 to 50 of the arm, and of "path"."""
    groups, depth = study.grasps["group"], study.grasps["penetration"]
    by_path = study.results("path").eta(PUSHES, TRIALS // 2)
    for arm in ARMS:
        found, each = study.results(arm), disturbances(arm)
        early, late = found.eta(each, 0, TRIALS // 2), found.eta(each, TRIALS // 2)
        rows = []
        for group in sorted({*groups.tolist()} - {-1}):
            members = np.flatnonzero(groups == group)
            by_eta = members[np.lexsort([depth[members], -early[members]])[0]]
            by_depth = members[depth[members].argmin()]
            rows.append([late[by_eta], late[members].mean(), late[by_depth], by_path[by_eta]])
        table = np.array(rows)
        yield [
            study.target,
            arm,
            len(table),
            *(mean_error(table[:, column]) for column in range(4)),
            mean_error(table[:, 0] - table[:, 1]),
            mean_error(table[:, 0] - table[:, 2]),
        ]


def smoothing_rows(study: Study) -> Iterable[list[object]]:
    """Mean squared errors [1e-3] of shrunk etas of ten trials against trials 26 to 50."""
    is_held = study.grasps["outcome"] == Outcome.HELD
    cells = np.floor(study.grasps["position"][is_held] * 100)
    apart = np.abs(cells[:, None] - cells[None]).max(axis=2)
    beside = (apart <= 1) & ~np.eye(len(cells), dtype=bool)
    found = study.results("path")
    few, late = (found.eta(PUSHES, *span)[is_held] for span in ((0, FEW), (TRIALS // 2, TRIALS)))
    whole = np.full(len(few), few.mean())
    near = np.where(beside.any(axis=1), beside @ few / np.maximum(beside.sum(axis=1), 1), whole)
    for name, towards in (("26 cells", near), ("run", whole)):
        errors = [((FEW * few + k * towards) / (FEW + k) - late) ** 2 for k in STRENGTHS]
        yield [study.target, name, *(mean_error(1e3 * error) for error in errors)]


def refinement_rows(study: Study) -> Iterable[list[object]]:
    """Fresh etas of grasps, of refined ones and of the best of as many trials of others."""
    for which in ("first", "best"):
        yield from refinement_row(study, which)


def refinement_row(study: Study, which: str) -> Iterable[list[object]]:
    """The row of the first or of the best grasps of groups."""
    found, cost = study.refined(which), study.seconds
    own, refined, neighbour = found["eta"].T
    trials, others = found["simulated"].mean(axis=0)
    trial_seconds = cost[1] + cost[2 + ARRIVALS.index("path")]
    yield [
        study.target,
        which,
        len(own),
        *(mean_error(each) for each in (own, refined, neighbour, refined - own, neighbour - own)),
        f"{trials:.0f} / {others:.0f}",
        f"{found['seconds'].mean():.2f} / {others * trial_seconds:.2f}",
        mean_error((refined - own) / found["seconds"].mean()),
        mean_error((neighbour - own) / max(others * trial_seconds, 1e-9)),
    ]


def way_rows(study: Study) -> Iterable[list[object]]:
    """Of grasps that hold: shares of trials that stop early, distance back [mm], shares held."""
    is_held = study.grasps["outcome"] == Outcome.HELD
    path, retreat = (study._arrivals[f"{arm} back"][is_held] for arm in ("path", "retreat"))
    holds, is_early = study.results("path").outcome[is_held] == Outcome.HELD, path > 0
    yield [
        study.target,
        f"{is_early.mean():.3f}",
        f"{(path != retreat).mean():.3f}",
        f"{1e3 * APPROACH_STEP * np.median(path[is_early]):.0f}",
        f"{holds[is_early].mean():.2f}",
        f"{holds[~is_early].mean():.2f}",
    ]


def cost_rows(study: Study) -> Iterable[list[object]]:
    """CPU time of a trial [ms]."""
    yield [study.target, *(f"{1e3 * each:.2f}" for each in study.seconds)]


TABLES = {
    "outcomes": (outcome_rows, ["object", "trials", *(outcome.name.lower() for outcome in [*Outcome][2:]),
                                "eta dropped", "eta shaken", "eta held", "real sd", "halves", "ranks"]),
    "choice": (choice_rows, ["object", "trials", "groups", "by eta", "mean", "by penetration",
                             "by eta, judged on path", "eta - mean", "eta - penetration"]),
    "smoothing": (smoothing_rows, ["object", "towards", *(f"K {k}" for k in STRENGTHS)]),
    "refinement": (refinement_rows, ["object", "of each group", "n", "own", "refined", "neighbour",
                                     "refined - own", "neighbour - own", "trials", "CPU s",
                                     "a CPU s, refined", "a CPU s, neighbour"]),
    "way": (way_rows, ["object", "stops early", "not retreat", "back, median", "held", "held if clear"]),
    "cost": (cost_rows, ["object", "paper", "way", *ARRIVALS]),
}  # fmt: skip


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.eta", description=__doc__)
    parser.add_argument("tables", nargs="*", help=f"of {', '.join(TABLES)}; none: all")
    parser.add_argument("--objects", nargs="+", default=[*EVALUATIONS], choices=[*EVALUATIONS])
    parser.add_argument("--folder", type=Path, default=Path("runs/eta"), help="keeps what was simulated")
    asked = parser.parse_args()
    if strange := {*asked.tables} - TABLES.keys():
        parser.error(f"no table is called {', '.join(sorted(strange))}; there are {', '.join(TABLES)}")
    asked.folder.mkdir(parents=True, exist_ok=True)
    studies = [Study(target, asked.folder) for target in asked.objects]
    for name in asked.tables or TABLES:
        rows_of, header = TABLES[name]
        table = Table(*header, title=name)
        for study in studies:
            for row in rows_of(study):
                table.add_row(*map(str, row))
            print(f"{name}: {study.target}", file=sys.stderr, flush=True)
        Console(width=220).print(table)


if __name__ == "__main__":
    main()
