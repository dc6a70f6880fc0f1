"""Reads, chooses and describes grasps of a run, some thousands at a time."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgpack
import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import running_sum
from qdgrasp_assets.gripper_setup.draft import original_base
from qdgrasp_assets.grippers.gripper_file import OriginalBase
from qdgrasp_assets.grippers.hand_model import coupling_error
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_assets.scene import Scene, SceneGripper, SceneObject, Vector, vector
from qdgrasp_coordinator.metrics.grasp_quality import NO_LIMITS, GraspLimits, taken_mask, takes_held
from qdgrasp_coordinator.metrics.successes import (
    TrialPlan,
    best_first,
    eta_bounds,
    find_successes,
    join_successes,
)
from qdgrasp_coordinator.storage.engine_table import TABLE, other_tables, verdicts
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import LIFT, Outcome
from qdgrasp_protocol.spec import APPROACH_DISTANCE, RunSpec, to_toml
from qdgrasp_protocol.text import counted, join_numbers
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import (
    COM,
    FITNESS_MEANING,
    LIFT_MEANING,
    POSE_WORDS,
    Frame,
    GraspColumn,
    GraspMetadata,
    RestingPoseRecord,
    SourceRun,
)
from qdgrasp_tools.export.grip import fixed_joints

if TYPE_CHECKING:
    from qdgrasp_assets.grippers.reachability import ReachabilityCheck
    from qdgrasp_tools.export.arm import Arm


def read_run(folder: RunFolder, least: Outcome = Outcome.DROPPED) -> Grasps:
    """Read the nominal evaluations of a run that got as far as `least`, in journal order.

    The run may still be in progress: what is recorded by now is read. `DROPPED` gives all successes, `MISSED`
    all that were simulated. Raises FolderError if the folder cannot be read, or has no scene yet.
    """
    with folder.journal() as journal:
        return read_journal(folder, journal, least)


def read_journal(
    folder: RunFolder, journal: Journal, least: Outcome, engines: Iterable[str] = (), name: str = ""
) -> Grasps:
    """Read them from a run's open journal, with verdicts in `engines` and those of its tables.

    `name` is what the run is called; empty: as its folder.
    """
    plan, blocks = TrialPlan.of(folder.spec), chain([journal.shape.empty(0)], journal.blocks())
    found = join_successes([*find_successes(blocks, plan, least=least)])
    is_known = (found.trials > 0) & ~np.isnan(found.scores)
    eta, trials = np.where(is_known, plan.eta(found.scores), np.nan), np.where(is_known, found.trials, 0)
    tables = dict.fromkeys(engines, np.zeros(0, TABLE)) | other_tables(folder)
    elsewhere = {
        engine: verdicts(table, found.numbers, found.rows["outcome"]) for engine, table in tables.items()
    }
    name = name or folder.path.absolute().name
    scene, spec, hard = folder.scene(), folder.spec, found.eta_hard
    return Grasps(scene, spec, name, found.numbers, found.rows, eta, trials, hard, elsewhere)


NO_APPROACH = (None, None, 0.0, None)
ALL_FAILURES = -1  # So many failures as there are


@dataclass(frozen=True)
class GraspChoice:
    """Flags that say which grasps of a run are taken; see `select_grasps`."""

    min_fitness: float | None = None
    """Disturbances survived in the nominal evaluation, at least; None: as of `taken_mask`."""
    min_quality: float = 0.0
    """Least confidence, 0 to 1."""
    top: int | None = None
    """At most so many, the best first: by the lower bound of eta where known (`best_first`)."""
    diverse: int | None = None
    """At most so many, each as far as can be from those before it (`spread_places`), the best first."""
    limits: GraspLimits = NO_LIMITS
    holds_in: str | None = None
    """Those that hold in this engine too, by the run's table of it."""
    approach_distance: float | None = None
    """Distance from which hands come to their poses, touching nothing [m]; None: as in the run."""
    resting_pose: int | str | None = None
    """How the object rests on a table that they come above, or "any"; None: as in the run."""
    arm: "Arm | None" = None
    """The arm that is asked whether it reaches them."""
    reachable: bool = False
    """True: those alone that it reaches."""

    def reachability(self, scene: Scene, spec: RunSpec) -> "ReachabilityCheck | None":
        """Return the check of how hands come to grasps; None: neither flags nor the run ask for it."""
        if (self.approach_distance, self.resting_pose, spec.approach, spec.table_pose) == NO_APPROACH:
            return None
        from qdgrasp_assets.grippers.reachability import ReachabilityCheck  # scipy takes its time

        return ReachabilityCheck.asked(scene, spec, self.approach_distance, self.resting_pose)


ALL_GRASPS = GraspChoice()


def select_grasps(grasps: Grasps, choice: GraspChoice = ALL_GRASPS) -> Grasps:
    """Select grasps that are good and within limits, of these the best, of these spread ones.

    If the grasps have an `approach`, those are taken whose hands come to their poses. Without `top` and
    `diverse` they are in journal order. Raises ImpossibleValue for other numbers, UnknownName for another
    engine, and InputError where there is no table of it.
    """
    for name in ("min_fitness", "top", "diverse"):
        if (value := getattr(choice, name)) is not None:
            _check_number(name, value, whole=name != "min_fitness")
    chosen = grasps[grasps.is_success & taken_mask(grasps.rows, grasps.spec, choice.min_fitness)]
    if choice.holds_in is not None:
        chosen = chosen[chosen.verdicts_in(choice.holds_in) == Outcome.HELD]
    chosen = chosen[choice.limits.admitted(chosen.rows, chosen.scene)]
    chosen = chosen[chosen.confidence >= choice.min_quality]
    if chosen.approach is not None:
        chosen = chosen[chosen.reach.is_reachable]
    if choice.reachable:
        chosen = chosen[_arm_columns(chosen, choice.arm)[0].values]
    if choice.top is None and choice.diverse is None:
        return chosen
    bounds = eta_bounds(chosen.eta, np.maximum(chosen.trials, 1))[0]
    chosen = chosen[best_first(chosen.rows, bounds, chosen.eta_hard)[: choice.top]]
    return chosen if choice.diverse is None else chosen[spread_places(chosen, choice.diverse)]


def _arm_columns(grasps: Grasps, arm: "Arm | None") -> tuple[GraspColumn, ...]:
    """Return whether an arm reaches grasps, and its joints there; nothing without one."""
    distance = grasps.approach.distance if grasps.approach else APPROACH_DISTANCE
    axis = np.array(grasps.scene.gripper.approach_axis)
    return () if arm is None else arm.columns(grasps.poses(arm.frame), axis, distance)


def _check_number(name: str, value: object, *, whole: bool) -> None:
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    if isinstance(value, bool) or not isinstance(value, kinds) or not 0 <= value < np.inf:
        raise ImpossibleValue(name, value, f"{'an integer' if whole else 'a number'} not less than 0")


def spread_places(grasps: Grasps, most: int) -> NDArray[np.int64]:
    """Choose at most `most` well-spread grasps: the first, then ever the farthest from those.

    The distance of two hands is the root of the sum of two squares: the distance of their root links, and the
    way that a point at the hand's reach from its root link moves when the one hand is turned as the other, 2
    reach sin(angle / 2). A jaw turned by 180 degrees about its approach axis is the same jaw. Of equally far
    ones the first is taken (Gonzalez 1985, "Clustering to minimize the maximum intercluster distance").
    """
    hands, gripper = grasps.matrices(COM), grasps.scene.gripper
    half_turn = np.eye(4)
    half_turn[:3, :3] = 2 * np.outer(gripper.approach_axis, gripper.approach_axis) - np.eye(3)
    same = (hands, hands @ half_turn) if gripper.jaw else (hands,)
    scale = gripper.reach / np.sqrt(2)
    # matrices of rotations lie the root of 8 sin2(angle / 2) apart
    variants = [np.hstack([each[:, :3, 3], scale * each[:, :3, :3].reshape(-1, 9)]) for each in same]
    nearest = np.full(len(hands), np.inf)
    chosen: list[int] = []
    while len(chosen) < min(most, len(hands)):
        place = int(np.argmax(nearest)) if chosen else 0
        chosen.append(place)
        for each in variants:
            nearest = np.minimum(nearest, ((each - variants[0][place]) ** 2).sum(axis=1))
        nearest[place] = -1.0
    return np.array(chosen, dtype=np.int64)


class ChosenGrasps(NamedTuple):
    """Grasps that were chosen from a run."""

    grasps: Grasps
    failures: int
    """The last so many are failures."""
    min_fitness: int
    """The others have this fitness or more."""
    unknown: int = 0
    """Grasps that were left out as their verdict in the engine that is asked for is not known."""
    arm: "Arm | None" = None

    @property
    def best(self) -> float | None:
        """The best confidence; None: there is no grasp."""
        confidence = self.grasps.confidence[: len(self.grasps) - self.failures]
        return float(confidence.max()) if len(confidence) else None


def choose_grasps(every: Grasps, choice: GraspChoice, failures: int = 0) -> ChosenGrasps:
    """Choose from the successes of a run, and from its failures if there are any among `every`.

    Behind the grasps stand failures, evaluations that were no grasps: at most so many, spread over the
    journal.
    """
    unknown, least = 0, choice.min_fitness
    if least is None:
        least = every.spec.disturbances if takes_held(every.spec) else 1
    if choice.holds_in is not None:
        known = select_grasps(every, GraspChoice(choice.min_fitness)).verdicts_in(choice.holds_in)
        unknown = int((known < 0).sum())
    every = replace(every, approach=choice.reachability(every.scene, every.spec))
    choice = replace(choice, arm=choice.arm and choice.arm.among(every.scene))
    found = select_grasps(every, choice)
    least = int(found.fitness.min(initial=least))  # a custom evaluator's grasps may hold with less
    places = np.searchsorted(every.numbers, found.numbers)
    others = np.setdiff1d(np.flatnonzero(~every.is_grasp), places) if failures else places[:0]
    if failures != ALL_FAILURES and failures < len(others):
        others = others[np.linspace(0, len(others) - 1, failures).round().astype(np.int64)]
    chosen = every[np.concatenate([places, others])]
    chosen = replace(chosen, more=_arm_columns(chosen, choice.arm))
    return ChosenGrasps(chosen, len(others), least, unknown, choice.arm)


ETA_WORDS = (
    "the share of disturbances survived in all trials with disturbed pose and friction, "
    "the estimated probability of transfer"
)
MESH_FILE = "the mesh file"
MESH_WRITTEN = "the mesh that `qdgrasp export --format graspgen --frame mesh` writes"
"""Mesh of an object that is built in or from the asset path."""
OBJECT_FRAMES: dict[Frame, str] = {
    "mesh": "that of {}: its origin and axes, its lengths times object_scale",
    "com": "origin at the centre of mass, axes of {}",
}
XYZW = "x, y, z, w"
MICROMETRE = 6  # Decimals of a length [m]


def _pose_words(grasps: Grasps) -> str:
    """Say which pose hands close from."""
    seated = np.count_nonzero(grasps.reseated)
    words = f"; of {seated} of {counted(len(grasps), 'grasp')} it is where an earlier evaluation settled"
    return f"{POSE_WORDS}{words} (reseated): there the object hardly moves" if seated else POSE_WORDS


def _settled_words(grasps: Grasps) -> str:
    """Say of how many successes the settled pose was recorded."""
    known, successes = np.count_nonzero(grasps.is_settled), np.count_nonzero(grasps.is_success)
    if known == successes:
        return "recorded of every success"
    return f"recorded of {known} of {successes} successes; the grasp pose of the others is the commanded one"


def grasp_metadata(chosen: ChosenGrasps, frame: Frame, journal: Journal) -> GraspMetadata:
    """Make the metadata of a file of a run's grasps, in a frame of the object."""
    grasps, scene = chosen.grasps, chosen.grasps.scene
    hand, body = scene.gripper, scene.object
    file = Path(grasps.spec.object).name if Path(grasps.spec.object).suffix else ""
    check, origin = grasps.approach, (0.0, 0.0, 0.0) if frame == COM else body.com_in_mesh
    names = {name: Path(getattr(grasps.spec, name)).name for name in ("gripper", "object")}
    public = msgspec.structs.replace(grasps.spec, poses=None, reseated=None, **names)
    runs = (SourceRun(run=grasps.run, digest=journal_digest(journal), spec=to_toml(public)),)
    error = coupling_error(hand, grasps.joints)
    return GraspMetadata(
        qdgrasp=version("qdgrasp"),
        gripper=hand.name,
        gripper_frame=hand.base_link,
        gripper_axes=f"those of link '{hand.base_link}'; it approaches along "
        f"({join_numbers(hand.approach_axis)})",
        gripper_source=_printable(hand.source),
        gripper_licence=_printable(hand.licence),
        gripper_sha256=part_digest(hand),
        fixed_joints=fixed_joints(grasps.spec.gripper),
        coupling_error=UNSET if error is None else error,
        original_base=scene_original_base(hand) or UNSET,
        object=body.name,
        object_file=file,
        object_scale=1.0 if grasps.spec.scale is None else grasps.spec.scale,
        object_frame=OBJECT_FRAMES[frame].format(MESH_FILE if file else MESH_WRITTEN),
        frame=frame,
        object_com=origin,
        com_in_mesh=body.com_in_mesh,
        object_size=vector(np.subtract(scene.object_high, scene.object_low).round(MICROMETRE)),
        object_mass=body.mass,
        object_friction=body.lateral_friction,
        object_source=_printable(body.source),
        object_licence=_printable(body.licence),
        object_sha256=part_digest(body),
        collision_parts=body.collision_source,
        quaternions=XYZW,
        protocol=scene.protocol,
        fitness=LIFT_MEANING if scene.protocol == LIFT else FITNESS_MEANING,
        min_fitness=chosen.min_fitness,
        confidence=_confidence_words(grasps.spec),
        poses=_pose_words(grasps),
        settled=_settled_words(grasps),
        approach_distance=UNSET if check is None else check.distance,
        resting_poses=_resting_poses(check, origin) if check and check.poses else UNSET,
        arm=chosen.arm.words if chosen.arm else UNSET,
        scene=journal.scene,
        runs=runs,
    )


def scene_original_base(gripper: SceneGripper) -> OriginalBase | None:
    """Return the base link of a hand's own URDF, where `--repair` added another; else None."""
    return original_base(gripper.base_link, scene_robot(gripper))


def _resting_poses(check: "ReachabilityCheck", origin: Vector) -> tuple[RestingPoseRecord, ...]:
    """Return resting poses in a frame in which the centre of mass is at `origin` [m]."""
    return tuple(
        RestingPoseRecord(
            number=number,
            up=pose.up,
            height=round(pose.height + running_sum(a * b for a, b in zip(pose.up, origin, strict=True)), 6),
            probability=pose.probability,
        )
        for number, pose in check.poses.items()
    )


def _confidence_words(spec: RunSpec) -> str:
    share = f"fitness / {spec.disturbances}"
    if not spec.trial_count:
        return share
    base = "" if spec.base == "paper" else f" under {spec.base}"
    return f"eta{base} of {spec.trial_count} trials, {ETA_WORDS}; where it is not known {share}"


def part_digest(part: SceneGripper | SceneObject) -> str:
    """Return the sha256 over the bytes of a part of a scene, as they are in its bundle."""
    values = msgspec.to_builtins(part, builtin_types=(bytes,), order="sorted")
    return hashlib.sha256(msgpack.packb(values, use_bin_type=True)).hexdigest()


def _printable(text: str) -> str:
    """Remove control characters, which formats have no place for; lines stay."""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")
