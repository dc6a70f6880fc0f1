"""Hand poses from outside, the search that asks each once, and their scores."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.scene import Scene, SceneGripper, SceneObject
from qdgrasp_coordinator.metrics.arrays import read_arrays, real_numbers
from qdgrasp_coordinator.metrics.cells import GenomeReader
from qdgrasp_coordinator.metrics.grasp_quality import (
    contact_values,
    object_motion,
    recorded_margins,
    settled_mask,
    settled_poses,
)
from qdgrasp_coordinator.metrics.successes import NO_TRIALS, TrialPlan, all_successes
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.rows import NO_SYNERGY, Genomes, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

ROUNDING = 1e-6  # Greatest error of a unit quaternion's length in float32
SHORTEST = 1e-6  # Least length of a quaternion that names a rotation
FARTHEST = 1000.0  # Greatest coordinate of hands and centres of mass [m]; farther, float32 loses digits


ARRAYS = ("base_position", "base_quaternion_xyzw", "synergy", "spread")
"""The arrays of a file of poses, in the order of the fields of `HandPoses`."""


@dataclass(frozen=True)
class HandPoses:
    """Poses of a hand's root link in the object's CoM frame; made by `of` or `read_poses`."""

    positions: NDArray[np.float64]
    """(n, 3) [m]."""
    quaternions: NDArray[np.float64]
    """(n, 4), xyzw, of any length but zero."""
    synergies: NDArray[np.int64]
    """(n,) labels; -1: no synergy."""
    spreads: NDArray[np.float64]
    """(n, k) positions of the free joints [rad or m]; NaN: the open posture."""
    where: str
    """Where they come from, for errors: a word or file with a colon, or nothing."""

    @classmethod
    def of(
        cls,
        positions: ArrayLike | None,
        quaternions_xyzw: ArrayLike | None,
        synergies: ArrayLike | None = None,
        spreads: ArrayLike | None = None,
        where: str = "",
    ) -> "HandPoses":
        """Make poses from arrays as in the fields; a NaN label, or None: no synergy, open posture.

        Raises `InputError` where an array has another type or shape, or an impossible number, or no pose.
        """
        places = real_numbers(f"{where}positions", positions, ("n", 3))
        n = len(places)
        rotations = real_numbers(f"{where}quaternions_xyzw", quaternions_xyzw, (n, 4))
        given = np.full(n, np.nan) if synergies is None else synergies
        labels = np.nan_to_num(real_numbers(f"{where}synergies", given, (n,)), nan=NO_SYNERGY)
        given = np.full((n, 0), np.nan) if spreads is None else spreads
        free = real_numbers(f"{where}spreads", given, (n, "k"))
        if not n:
            raise InputError(f"{where}positions holds no poses.")
        lengths = np.linalg.norm(rotations, axis=1)
        for name, values, is_right, expected in (
            ("positions", places, np.abs(places) <= FARTHEST, f"no more than {FARTHEST:g} m away; in metres"),
            ("quaternions_xyzw", lengths, (lengths > SHORTEST) & (lengths < np.inf), "not of length zero"),
            ("synergies", labels, np.isin(labels, np.arange(-128, 128)), "integers"),
            ("spreads", free, ~(np.abs(free) > FARTHEST), f"within {FARTHEST:g} rad or m of 0"),
        ):
            if not is_right.all():
                raise ImpossibleValue(f"{where}{name}", float(values[~is_right][0]), expected)
        return cls(places, rotations, labels.astype(np.int64), free, where)

    def __len__(self) -> int:
        return len(self.positions)

    def check(self, hand: SceneGripper) -> None:
        """Check that a hand has the synergies and free joints that poses ask for."""
        known, free = len(hand.synergies), len(hand.free_joints)
        wrong = self.synergies[(self.synergies < NO_SYNERGY) | (self.synergies >= known)]
        if len(wrong):
            labels = f"-1 (none) or 0 to {known - 1} for this hand" if known else "-1, for the hand has none"
            raise ImpossibleValue(f"{self.where}synergies", int(wrong[0]), labels)
        behind = self.spreads[:, free:]
        if len(given := behind[~np.isnan(behind)]):
            columns = (
                f"NaN but in the first {free} columns" if free else "NaN, for the hand has no free joints"
            )
            raise ImpossibleValue(f"{self.where}spreads", float(given[0]), columns)

    def genomes(self, scene: Scene) -> NDArray[np.float32]:
        """Return genomes of the prior `given` (assets, `layout`): pose, then synergy, free joints."""
        hand = scene.gripper
        self.check(hand)
        columns = [self.positions, _unit_quaternions(self.quaternions)]
        if hand.synergies:
            columns.append(self.synergies[:, None].astype(np.float64))
        if hand.free_joints:
            columns.append(self._free(hand))
        return np.hstack(columns).astype(np.float32)

    def _free(self, hand: SceneGripper) -> NDArray[np.float64]:
        opened, count = {joint.name: joint.opened for joint in hand.joints}, len(hand.free_joints)
        default = np.array([opened[joint.name] for joint in hand.free_joints])
        given = np.full((len(self), count), np.nan)
        given[:, : self.spreads.shape[1]] = self.spreads[:, :count]
        return np.where(np.isnan(given), default, given)


def check_given(where: str, genomes: Genomes, hand: SceneGripper) -> None:
    """Check genomes (n, d) of the prior `given`: as `HandPoses.of`, and for a hand."""
    labels, own = (genomes[:, 7], 8) if hand.synergies else (None, 7)
    HandPoses.of(genomes[:, :3], genomes[:, 3:7], labels, genomes[:, own:], where).check(hand)


def check_spec_poses(spec: RunSpec, hand: SceneGripper, genes: int) -> None:
    """Check the poses of a spec, if it has any, for a hand and genomes of so many genes."""
    if spec.poses:
        fixed_pose_search(spec, genes)
        check_given("poses: ", np.array(spec.poses, np.float32), hand)


def read_poses(path: Path) -> HandPoses:
    """Return the poses in an npz file; `InputError` as in `read_arrays` and `HandPoses.of`."""
    arrays = read_arrays(path, "poses")
    if lacking := [name for name in ARRAYS[:2] if name not in arrays]:
        raise InputError(f"{path} has no array '{lacking[0]}'; it has {', '.join(sorted(arrays)) or 'none'}.")
    places, rotations, labels, free = map(arrays.get, ARRAYS)
    return HandPoses.of(places, rotations, labels, free, f"{path}: ")


def as_given(scene: Scene, prior: str, rows: Rows) -> Genomes:
    """Return the genomes of the prior `given` (n, d) with the very poses of rows of `prior`.

    Evaluated, they give the same outcome, fitness and trials bit for bit.
    """
    hand = scene.gripper
    values = GenomeReader.of(scene, prior).values(rows["genome"]).astype(np.float64)
    own = values.shape[1] - bool(hand.synergies) - len(hand.free_joints)
    if hand.synergies:
        values[:, own] = np.rint(values[:, own])
    return np.hstack([rows["base_to_object"], values[:, own:]]).astype(np.float32)


def write_scores(path: Path, rows: Rows, body: SceneObject, plan: TrialPlan = NO_TRIALS) -> None:
    """Write `scores` of rows to a new file, in the order of the poses."""
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **scores(rows, body, plan))


def scores(rows: Rows, body: SceneObject, plan: TrialPlan = NO_TRIALS) -> dict[str, NDArray[np.generic]]:
    """Return scores of a journal's rows, as arrays by name; nominal rows only, but for eta.

    valid, touched, success: (n,) bool; fitness: (n,) uint8, false and 0 for overlaps; outcome: (n,) uint8
    (`Outcome`); base_position (n, 3) and base_quaternion_xyzw (n, 4) as simulated, float32; joints (n, j)
    after closing; contacts (n,) finger links in contact; penetration (n,) [m]. After closing, NaN for all but
    successes: settled_position and settled_quaternion_xyzw of the hand; motion (n, 2) of the object meanwhile
    [m, rad]; margin (n,) of the contacts (Ferrari-Canny). contact_links (n, k): places in the hand's links,
    -1 for an empty slot, of contact_points and contact_normals (n, k, 3), contact_forces (n, k) [N]. Where
    the plan has trials, eta (n,): the estimated probability that it transfers, 0 for all but successes.
    """
    found = all_successes(rows, plan, least=Outcome.ERROR)
    etas, rows = {"eta": plan.eta(found.scores)} if plan.trials else {}, found.rows
    outcome, contacts = rows["outcome"], contact_values(rows)
    settled = np.where(settled_mask(rows)[:, None], settled_poses(rows), np.nan)
    return etas | {
        "valid": outcome >= Outcome.MISSED,
        "touched": outcome >= Outcome.BRUSHED,
        "success": outcome >= Outcome.DROPPED,
        "fitness": rows["fitness"].astype(np.uint8),
        "outcome": outcome,
        "base_position": rows["base_to_object"][:, :3],
        "base_quaternion_xyzw": rows["base_to_object"][:, 3:],
        "joints": rows["joints"],
        "contacts": rows["contacts"],
        "penetration": rows["penetration"],
        "settled_position": settled[:, :3],
        "settled_quaternion_xyzw": settled[:, 3:],
        "motion": object_motion(rows),
        "margin": recorded_margins(rows, body),
        "contact_links": rows["contact_links"].astype(np.int16) - 1,
        "contact_points": contacts[..., :3],
        "contact_normals": contacts[..., 3:6],
        "contact_forces": contacts[..., 6],
    }


def _unit_quaternions(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalise quaternions (n, 4); those of length one within float32 rounding stay as stored."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.where(np.abs(lengths - 1.0) < ROUNDING, quaternions, quaternions / lengths)


class FixedPoseSearch:
    """Asks given poses in their order, at most `population` in a generation, each once.

    They are (n, d) float32 in the layout of `layout(scene, GIVEN)`, and not confined to [-1, 1].
    """

    def __init__(self, poses: Genomes, population: int) -> None:
        self._poses = poses
        self._population = population

    def ask(self, generation: int) -> Genomes:
        """The next poses; no rows when all have been asked."""
        first = generation * self._population
        return self._poses[first : first + self._population]

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn nothing."""


def check_poses(spec: RunSpec) -> None:
    """Check that a spec has poses, finite ones, and no greater budget than these."""
    if spec.poses is None:
        raise ImpossibleValue("poses", None, f"lists of numbers for method '{spec.method}'")
    if spec.evaluations > len(spec.poses):
        raise ImpossibleValue(
            "evaluations", spec.evaluations, f"at most {len(spec.poses)}, one for each pose"
        )
    if not all((np.abs(pose) <= np.finfo(np.float32).max).all() for pose in spec.poses):
        raise ImpossibleValue("poses", "one with a number that is not finite", "lists of finite numbers")


def fixed_pose_search(spec: RunSpec, genes: int) -> FixedPoseSearch:
    """Return the search over the poses of a spec, each of `genes` numbers."""
    check_poses(spec)
    poses = spec.poses or ()
    if wrong := {len(pose) for pose in poses} - {genes}:
        expected = f"lists of {genes} numbers for this hand: the pose, synergy and free joints"
        raise ImpossibleValue("poses", f"one of {wrong.pop()}", expected)
    return FixedPoseSearch(np.array(poses, dtype=np.float32), spec.population)
