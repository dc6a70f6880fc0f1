"""Measures the survival of a run's grasps under disturbances unused in their ranking.

A run of the default method under `physical` in MuJoCo is ranked as `qdgrasp rerank` ranks it: trials of
`robust` with `base = "physical"`, sequential ones. The best by eta, and others drawn at random, are then
simulated once more in worlds that differ from the one that they were found in.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from benchmarks.physics.calibration.table import GraspRow, Group, Origin, RunKey, grasp_row
from benchmarks.physics.eta import Arrays, cached_arrays, evaluated
from benchmarks.results.measure import HEX
from benchmarks.single_run import run as single_run
from msgspec.structs import replace as changed
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.rotation import from_euler, multiply
from qdgrasp_assets.scene import Scene, pack_scene
from qdgrasp_coordinator.metrics.grasp_quality import MM, object_motion, recorded_margins
from qdgrasp_coordinator.metrics.scores import genome_numbers, nominal_scores
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_protocol.engines import EngineName
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import GIVEN, Genomes, Outcome, Rows
from qdgrasp_protocol.spec import ProtocolName, RunSpec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.ranking import best_of_kinds
from qdgrasp_tools.cli.run_commands import CANDIDATES
from qdgrasp_worker.decoder import Decoder, HandPose
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.engines.mujoco_simulation import SimulationDiverged
from qdgrasp_worker.engines.mujoco_world import MujocoPhysicalWorld
from qdgrasp_worker.evaluation_protocols import (
    PHYSICAL,
    PROTOCOLS,
    SMALL_MIXTURE,
    Physics,
    TrialSetup,
    pose_seed,
    round_to_float32,
)
from qdgrasp_worker.evaluator import Evaluator, make_episode
from qdgrasp_worker.object_geometry import ObjectSurface

SCENES = tuple(
    (hand, target)
    for hand in ("panda", "allegro")
    for target in ("ycb_bowl", "ycb_mug", "ycb_bleach_cleanser", "ycb_power_drill")
)
"""The hands and objects of the robot experiments of Huber et al. 2024, appendix."""
SEEDS = (0, 1, 2)
EVALUATIONS = {"panda": 3000, "allegro": 1500}
"""Budgets of runs; other hands have the least."""
ARM_SEED = 1  # Of the arm's errors; the ranking's trials have the mixture's own, 0


@dataclass(frozen=True)
class Design:
    """The numbers of the study of a run."""

    evaluations: int
    """Budget of the run."""
    best: int = 20
    """Grasps taken by their rank."""
    held: int = 20
    """Grasps drawn of the others that hold."""
    successes: int = 20
    """Grasps drawn of the successes that are left."""
    trials: int = 30
    """Trials of a drawn grasp; a ranked one has those of its ranking."""
    arm: int = 10
    """Number of errors of the arm for each grasp."""

    @property
    def words(self) -> str:
        """All numbers in one text, as in the table."""
        return " ".join(f"{name}={value}" for name, value in asdict(self).items())


def design_of(hand: str, evaluations: int | None = None, **numbers: int) -> Design:
    """The design of runs of a hand; its budget is the hand's where none is given."""
    return Design(evaluations or EVALUATIONS.get(hand, min(EVALUATIONS.values())), **numbers)


@dataclass(frozen=True)
class Disturbance:
    """A change of the world in which grasps are simulated once more."""

    name: str
    """Its column in the table."""
    label: str
    words: str
    """Its label, explained."""
    is_unseen: bool = True
    """True: of another kind than the ranking's disturbances, or greater."""
    protocol: ProtocolName = "physical"
    engine: EngineName = "mujoco"
    physics: Mapping[str, float] = field(default_factory=dict)
    """Factors of settings of `Physics`."""
    grip: float = 1.0
    """Factor of the object's lateral friction."""
    effort: float = 1.0
    """Factor of the greatest force or torque of every finger's drive."""
    moves_arm: bool = False

    def trials(self, pose: HandPose, errors: int) -> list[TrialSetup]:
        """The trials of a grasp: one, or one for each error of the arm."""
        if self.moves_arm:
            return [arm_error(pose, number) for number in range(1, errors + 1)]
        return [TrialSetup(pose, grip=self.grip)]


IN_BULLET = Disturbance("bullet", "Bullet", "undisturbed, in the other engine", engine="bullet")
"""The second engine's verdict, by which grasps are chosen."""
DISTURBANCES = (
    Disturbance("friction_050", "friction x 0.5", "lateral friction of the object", grip=0.5),
    Disturbance(
        "weight_200", "weight x 2", "each push is twice the object's weight", physics={"weight": 2.0}
    ),
    Disturbance("weight_500", "weight x 5", "five times", physics={"weight": 5.0}),
    Disturbance(
        "torsion_017", "torsion 1.7 mm", "spinning friction, in place of 5 mm", physics={"spinning": 1 / 3}
    ),
    Disturbance("effort_070", "effort x 0.7", "greatest force or torque of every finger's drive", effort=0.7),
    Disturbance(
        "together",
        "friction x 0.5, weight x 2, torsion 1.7 mm, effort x 0.7",
        "these four together",
        physics={"weight": 2.0, "spinning": 1 / 3},
        grip=0.5,
        effort=0.7,
    ),
    Disturbance(
        "paper_bullet",
        "shakes of paper in Bullet",
        "the protocol `paper` from the commanded pose, its closing too",
        protocol="paper",
        engine="bullet",
    ),
    Disturbance(
        "friction_070", "friction x 0.7", "lateral friction of the object", is_unseen=False, grip=0.7
    ),
    Disturbance(
        "arm",
        "error of the arm",
        "the hand arrives displaced by N(0, 3 mm) along each axis and turned about its base by three angles "
        "N(0, 3 degrees)",
        is_unseen=False,
        moves_arm=True,
    ),
)
UNSEEN = tuple(each for each in DISTURBANCES if each.is_unseen)
SEEN = tuple(each for each in DISTURBANCES if not each.is_unseen)


def arm_error(pose: HandPose, number: int) -> TrialSetup:
    """A grasp at which the arm arrives with an error of the hand's base link.

    It is displaced by N(0, 3 mm) along each axis and turned about itself by three angles N(0, 3 degrees), and
    comes along its approach axis as in a trial of `robust`. The error is a function of grasp and number.
    """
    random = np.random.default_rng([ARM_SEED, *pose_seed(pose), number])
    offset = random.normal(0.0, SMALL_MIXTURE.position_sigma, 3)
    turn = from_euler(random.normal(0.0, SMALL_MIXTURE.angle_sigma, (1, 3)))[0]
    moved = replace(
        pose,
        position=round_to_float32(np.array(pose.position) + offset),
        quaternion=round_to_float32(multiply(turn, np.array(pose.quaternion))),
    )
    return TrialSetup(moved, approaches=True)


def held_shares(
    spec: RunSpec, disturbance: Disturbance, poses: Sequence[HandPose], errors: int
) -> NDArray[np.float64]:
    """The share (n,) of a disturbance's trials in which each grasp of a run's scene is held.

    A trial on which the simulator fails counts as lost.
    """
    scene = build_scene(changed(spec, protocol=disturbance.protocol, engine=disturbance.engine))
    if disturbance.effort != 1.0:
        scene = weakened(scene, disturbance.effort)
    rules = PROTOCOLS[disturbance.protocol]
    if disturbance.physics:
        nominal = Physics()
        values = {name: factor * getattr(nominal, name) for name, factor in disturbance.physics.items()}
        rules = replace(rules, physics=replace(nominal, **values))
    with closing(make_world(scene, rules)) as world:
        episode = make_episode(world, rules)

        def is_held(trial: TrialSetup) -> bool:
            try:
                return episode.run(trial).outcome is Outcome.HELD
            except SimulationDiverged:
                return False

        return np.array([np.mean([*map(is_held, disturbance.trials(pose, errors))]) for pose in poses])


def weakened(scene: Scene, factor: float) -> Scene:
    """A scene of `physical` in which every finger's drive gives a share of its greatest force or torque."""
    with closing(make_world(scene, PHYSICAL, "mujoco")) as world:
        assert isinstance(world, MujocoPhysicalWorld)
        limits = {drive.name: drive.limit for drive in world.drives}
    joints = tuple(changed(joint, rated_effort=factor * limits[joint.name]) for joint in scene.gripper.joints)
    return changed(scene, gripper=changed(scene.gripper, joints=joints))


def choose(
    outcomes: NDArray[np.integer], ranked: NDArray[np.integer], design: Design, seed: int
) -> dict[Group, list[int]]:
    """The places of the grasps of each group, none in two, among successes with these outcomes (n,).

    `ranked` (r,) are places of those that were ranked, best first. Draws follow from the seed; of a group
    that has too few there are fewer.
    """
    best = ranked[: design.best].tolist()
    others = [
        place
        for place in np.random.default_rng(seed).permutation(len(outcomes)).tolist()
        if place not in best
    ]
    held = [place for place in others if outcomes[place] == Outcome.HELD][: design.held]
    return {"best": best, "held": held, "success": [p for p in others if p not in held][: design.successes]}


class Study:
    """The grasps of one run and their survival; simulations are stored in a folder."""

    def __init__(self, run: RunKey, design: Design, folder: Path) -> None:
        self.run = run
        self._design = design
        self._folder = folder
        self.spec = full_spec(
            {
                "gripper": run.gripper,
                "object": run.object,
                "protocol": "physical",
                "engine": "mujoco",
                "evaluations": design.evaluations,
                "seed": run.seed,
                "surface_seed": run.seed,
            }
        )

    def _cached(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """Arrays of a file, made where there is none."""
        stem = f"{self.run.gripper}-{self.run.object}-s{self.run.seed}-{name}"
        return cached_arrays(self._folder / f"{stem}.npz", make)

    @cached_property
    def scene(self) -> Scene:
        """The scene that the grasps were found in."""
        return build_scene(self.spec)

    @cached_property
    def successes(self) -> Rows:
        """The successes of the run, in its order."""

        def make() -> Arrays:
            rows = single_run(self.spec).rows
            return {"rows": rows[rows["outcome"] >= Outcome.DROPPED]}

        return self._cached("run", make)["rows"]

    def genomes(self, places: Sequence[int]) -> Genomes:
        """Genomes of the prior `given` of successes."""
        return as_given(self.scene, prior_of(self.spec), self.successes[places])

    @cached_property
    def ranking(self) -> Arrays:
        """Places of the candidates, best first, with their eta and number of trials."""
        return self._cached("ranking", self._rank)

    def _rank(self) -> Arrays:
        """Rank as `qdgrasp rerank` does; of equal etas the greater margin comes first."""
        grasps = self.successes[self.successes["outcome"] >= Outcome.SHAKEN]
        if not len(grasps):
            budget = counted(self._design.evaluations, "evaluation")
            raise InputError(f"{self.run.words}: no grasp in {budget}; take more with --evaluations.")
        candidates = best_of_kinds(grasps, CANDIDATES * self._design.best, self.scene.object)
        places = np.searchsorted(genome_numbers(self.successes), genome_numbers(candidates))
        spec = self._trials_spec(self.genomes(places.tolist()))
        found, plan = single_run(spec).rows, TrialPlan.of(spec)
        scores, trials = nominal_scores(found, plan)
        etas = plan.eta(scores)
        order = np.lexsort((-self.margins[places], -etas, -trials))
        return {"places": places[order], "eta": etas[order], "trials": trials[order]}

    def _trials_spec(self, genomes: Genomes) -> RunSpec:
        poses = [[float(str(number)) for number in genome] for genome in genomes]
        return full_spec(
            {
                "gripper": self.run.gripper,
                "object": self.run.object,
                "protocol": "robust",
                "base": "physical",
                "engine": "mujoco",
                "surface_seed": self.run.seed,
                "method": GIVEN,
                "poses": poses,
                "evaluations": len(poses),
                "population": len(poses),
                "overlaps": "count",
                "trials": "sequential",
                "finalists": self._design.best,
            }
        )

    @cached_property
    def margins(self) -> NDArray[np.float64]:
        """(n,): Ferrari-Canny margins of the successes."""
        return recorded_margins(self.successes, self.scene.object)

    @cached_property
    def chosen(self) -> list[tuple[Group, int, int]]:
        """Group, number in it, and place among the successes of every grasp that is looked at."""
        groups = choose(self.successes["outcome"], self.ranking["places"], self._design, self.run.seed)
        return [
            (group, number, place)
            for group, places in groups.items()
            for number, place in enumerate(places, start=1)
        ]

    def _etas(self) -> list[tuple[float, int]]:
        """Eta and number of trials of the chosen grasps."""
        columns = (self.ranking[name].tolist() for name in ("places", "eta", "trials"))
        known = {place: (eta, trials) for place, eta, trials in zip(*columns, strict=True)}
        drawn = [place for group, _, place in self.chosen if group != "best"]

        def make() -> Arrays:
            spec = changed(self.spec, protocol="robust", base="physical")
            with Evaluator(build_scene(spec)) as evaluator:
                return evaluated(evaluator, self.genomes(drawn), range(1, self._design.trials + 1))

        fitness = self._cached("trials", make)["fitness"].reshape(len(drawn), self._design.trials)
        etas = fitness.mean(axis=1) / self.spec.disturbances
        known |= {place: (float(eta), self._design.trials) for place, eta in zip(drawn, etas, strict=True)}
        return [known[place] for _, _, place in self.chosen]

    def _shares(self, disturbance: Disturbance) -> list[float]:
        def make() -> Arrays:
            decode = Decoder(self.scene, GIVEN, ObjectSurface(self.scene))
            poses = decode(self.genomes([place for _, _, place in self.chosen]))
            each = [poses[i] for i in range(len(poses))]
            return {"held": held_shares(self.spec, disturbance, each, self._design.arm)}

        shares: list[float] = self._cached(disturbance.name, make)["held"].tolist()
        return shares

    def measure(self, origin: Origin) -> list[GraspRow]:
        """The rows of the run."""
        places = [place for _, _, place in self.chosen]
        rows, etas = self.successes[places], self._etas()
        shares = {each.name: self._shares(each) for each in (IN_BULLET, *DISTURBANCES)}
        motion = object_motion(rows)[:, 0] / MM
        scene = pack_scene(self.scene).digest[:HEX]
        return [
            grasp_row(
                {
                    **self.run._asdict(),
                    **origin._asdict(),
                    "scene": scene,
                    "group": group,
                    "place": number,
                    "generation": int(rows["generation"][i]),
                    "index": int(rows["index"][i]),
                    "fitness": int(rows["fitness"][i]),
                    "eta": etas[i][0],
                    "trials": etas[i][1],
                    "margin": float(self.margins[place]),
                    "penetration_mm": float(rows["penetration"][i]) / MM,
                    "motion_mm": float(motion[i]),
                    **{name: values[i] for name, values in shares.items()},
                }
            )
            for i, (group, number, place) in enumerate(self.chosen)
        ]
