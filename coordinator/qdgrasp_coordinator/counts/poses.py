"""Hand poses that come from outside, and the scores that go back."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.counts.arrays import read_arrays
from qdgrasp_coordinator.counts.scores import eta, sums
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.genome import GIVEN, NO_SYNERGY, Genomes
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

ROUNDING = 1e-6
"""How far float32 may take a unit quaternion's length from one."""


@dataclass(frozen=True)
class Poses:
    """Poses of a hand's root link in the object's centre-of-mass frame."""

    positions: NDArray[np.float64]
    """(n, 3) [m]."""
    quaternions: NDArray[np.float64]
    """(n, 4), xyzw, of any length but zero."""
    synergies: NDArray[np.int64]
    """(n,) labels; -1: none."""
    spreads: NDArray[np.float64]
    """(n, k) positions of the free joints [rad]; NaN: the open posture."""

    def __len__(self) -> int:
        return len(self.positions)

    def genomes(self, scene: Scene) -> NDArray[np.float32]:
        """The genomes of the prior `given` (assets, `layout`): the pose, then synergy and free joints."""
        columns = [self.positions, _unit(self.quaternions)]
        if scene.gripper.synergies:
            columns.append(self._labels(len(scene.gripper.synergies))[:, None])
        if free := scene.gripper.free_joints:
            columns.append(self._free(scene, len(free)))
        return np.hstack(columns).astype(np.float32)

    def _labels(self, known: int) -> NDArray[np.float64]:
        wrong = self.synergies[(self.synergies < NO_SYNERGY) | (self.synergies >= known)]
        if len(wrong):
            raise InputError(f"synergy must be -1 (none) or 0 to {known - 1} for this hand, got {wrong[0]}.")
        return self.synergies.astype(np.float64)

    def _free(self, scene: Scene, count: int) -> NDArray[np.float64]:
        opened = {joint.name: joint.opened for joint in scene.gripper.joints}
        default = np.array([opened[joint.name] for joint in scene.gripper.free_joints])
        given = np.full((len(self), count), np.nan)
        given[:, : self.spreads.shape[1]] = self.spreads[:, :count]
        return np.where(np.isnan(given), default, given)


def read_poses(path: Path) -> Poses:
    """The poses in an npz file.

    Raises
    ------
    InputError
        The file cannot be read, lacks an array, or holds one of the wrong shape or with impossible numbers.
    """
    arrays = read_arrays(path, "poses")
    positions = _array(arrays, "base_position", 3, path)
    quaternions = _array(arrays, "base_quaternion_xyzw", 4, path)
    n = len(positions)
    if len(quaternions) != n:
        raise InputError(f"{path}: base_position has {n} rows, base_quaternion_xyzw {len(quaternions)}.")
    if n == 0:
        raise InputError(f"{path} holds no poses.")
    if (np.linalg.norm(quaternions, axis=1) < 1e-6).any():
        raise InputError(f"{path}: base_quaternion_xyzw holds a quaternion of length zero.")
    synergies = np.asarray(arrays.get("synergy", np.full(n, NO_SYNERGY)))
    spreads = np.asarray(arrays.get("spread", np.full((n, 2), np.nan)))
    numeric = synergies.dtype.kind in "fiu" and spreads.dtype.kind in "fiu"
    if not numeric or synergies.shape != (n,) or spreads.ndim != 2 or len(spreads) != n:
        raise InputError(f"{path}: synergy must be numbers of shape ({n},) and spread of shape ({n}, 2).")
    labels = np.where(np.isnan(synergies.astype(np.float64)), NO_SYNERGY, synergies)
    if np.isinf(labels).any() or np.isinf(spreads.astype(np.float64)).any():
        raise InputError(f"{path}: synergy or spread holds a number that is infinite.")
    return Poses(positions, quaternions, labels.astype(np.int64), spreads.astype(np.float64))


def as_given(scene: Scene, prior: str, rows: Rows) -> Genomes:
    """The genomes of the prior `given` (n, d) that stand for the very poses of rows with genomes of `prior`.

    Evaluated, they give the same outcome, fitness and trials bit for bit. In a merged journal zeros may stand
    behind the genes.
    """
    known, hand = layout(scene, prior), scene.gripper
    genomes = rows["genome"][:, : len(known)]
    values = genomes.astype(np.float64) if prior == GIVEN else known.values(genomes)
    own = len(known) - bool(hand.synergies) - len(hand.free_joints)
    if hand.synergies:
        values[:, own] = np.rint(values[:, own])
    return np.hstack([rows["base_to_object"], values[:, own:]]).astype(np.float32)


def postures(scene: Scene, prior: str, rows: Rows) -> NDArray[np.float32]:
    """The joint positions (n, j) [rad or m] that hands start from: open, free joints as the genomes say."""
    given = as_given(scene, prior, rows)
    return opened(scene.gripper, given[:, given.shape[1] - len(scene.gripper.free_joints) :])


def opened(gripper: SceneGripper, spreads: NDArray[np.float32]) -> NDArray[np.float32]:
    """The joint positions (n, j) of the open posture, with free joints at `spreads` (n, k)."""
    names = [joint.name for joint in gripper.joints]
    starts = np.tile(np.array([joint.opened for joint in gripper.joints], np.float32), (len(spreads), 1))
    starts[:, [names.index(joint.name) for joint in gripper.free_joints]] = spreads
    return starts


def write_scores(path: Path, rows: Rows, trials: int = 0) -> None:
    """Write scores beside each other, in the order of the poses; a half-written file never appears.

    Parameters
    ----------
    rows, trials
        As in `scores`.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    partial = path.with_name(f".{path.name}.part")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **scores(rows, trials))
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(f"No scores can be written to '{path}': {error.strerror or error}.") from None


def scores(rows: Rows, trials: int = 0) -> dict[str, NDArray[np.generic]]:
    """Scored rows, of a journal, as arrays by name; of nominal ones but for eta.

    valid, touched, success: (n,) bool; fitness: (n,) uint8, false and 0 for overlaps; outcome: (n,) uint8
    (`Outcome`); base_position (n, 3) and base_quaternion_xyzw (n, 4) as simulated, float32; joints (n, j)
    after closing; contacts (n,) finger links in contact; penetration (n,) [m]. Where each success has
    `trials` trials, eta (n,): the estimated probability that it transfers, 0 for what is no success.
    """
    etas = {"eta": eta(sums(rows, trials), trials)} if trials else {}
    rows = rows[rows["trial"] == 0]
    outcome = rows["outcome"]
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
    }


def _unit(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same rotations (n, 4) at length one; what float32 alone keeps from it stays as it is stored."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.where(np.abs(lengths - 1.0) < ROUNDING, quaternions, quaternions / lengths)


def _array(
    arrays: Mapping[str, NDArray[np.generic]], name: str, width: int, path: Path
) -> NDArray[np.float64]:
    if name not in arrays:
        raise InputError(f"{path} has no array '{name}'; it has {', '.join(sorted(arrays)) or 'none'}.")
    array = arrays[name]
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {name} must be numbers of shape (n, {width}), got {array.shape}.")
    if not np.isfinite(array).all():
        raise InputError(f"{path}: {name} holds a number that is not finite.")
    return array.astype(np.float64)
