"""Checking what files of others tell: numbers that are finite and can be, rotations that are ones."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.counts.poses import FARTHEST
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.told import Told, Unusable
from qdgrasp_protocol.errors import InputError

OFF_UNIT = 1e-2
"""A quaternion may be so much longer or shorter than one, and a matrix so far from a rotation."""


def check(path: Path, told: Told) -> None:
    """Check that a file tells grasps that can be.

    Raises
    ------
    Unusable
        There is none, a number is not finite or cannot be, or a quaternion is not one of a rotation.
    """
    if not len(told):
        raise Unusable(path, "there is none in it")
    check_positions(path, told.names, told.poses)
    lengths = np.linalg.norm(told.poses[:, 3:], axis=1)
    unit = np.asarray(np.abs(lengths - 1.0) <= OFF_UNIT)
    wrong = lengths[~unit][0] if not unit.all() else 1.0
    _check_each(path, told.names, unit, f"its quaternion must be of length 1, and is of length {wrong:.4g}")
    for joint, values in told.starts.items():
        _check_each(path, told.names, ~np.isinf(values), f"joint '{joint}' is infinite")
    for what, value in (("scale", told.scale), ("mass", told.mass), ("friction", told.friction)):
        _check_positive(path, f"the object's {what}", value)
    if told.about:
        _check_about(path, told.about)


def check_positions(path: Path, names: NDArray[np.str_], poses: Floats) -> None:
    """Check that poses (n, 7) are finite, and near enough for their digits to tell something.

    Raises
    ------
    Unusable
        One is not.
    """
    finite = np.asarray(np.isfinite(poses).all(axis=1))
    _check_each(path, names, finite, "its pose holds a number that is not finite")
    near = np.asarray((np.abs(poses[:, :3]) <= FARTHEST).all(axis=1))
    _check_each(path, names, near, f"its position is more than {FARTHEST:g} m away; lengths are metres")


def check_matrices(path: Path, matrices: Floats) -> None:
    """Check that matrices (n, 4, 4) are homogeneous ones of rigid motions.

    Raises
    ------
    Unusable
        One is not.
    """
    turns = matrices[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        is_finite = np.isfinite(matrices).all(axis=(1, 2))
        off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        is_rigid = is_finite & (off <= OFF_UNIT) & (np.linalg.det(turns) > 0)
        is_rigid &= (matrices[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    if not is_rigid.all():
        number = int(np.flatnonzero(~is_rigid)[0])
        raise Unusable(path, f"transform {number} is not a rotation and a translation")


def _check_about(path: Path, about: About) -> None:
    """Check the numbers that a file of ours says of itself, and the specs of its runs."""
    for name in ("object_scale", "object_mass"):
        _check_positive(path, name, getattr(about, name))
    if not 0 <= about.object_friction < np.inf:
        raise Unusable(path, f"object_friction in it must not be negative, and is {about.object_friction:g}")
    for name in ("object_com", "com_in_mesh"):
        if not all(abs(value) <= FARTHEST for value in getattr(about, name)):
            raise Unusable(path, f"{name} in it must be finite, and not more than {FARTHEST:g} m away")
    for origin in about.runs:
        try:
            _ = origin.asked
        except InputError as error:
            why = str(error).rstrip(".")
            raise Unusable(path, f"the spec of run '{origin.run[:40]}' in it cannot be read: {why}") from None


def _check_positive(path: Path, what: str, value: float | None) -> None:
    if value is not None and not 0 < value < np.inf:
        raise Unusable(path, f"{what} in it must be a number greater than 0, and is {value:g}")


def _check_each(path: Path, names: NDArray[np.str_], good: NDArray[np.bool_], what: str) -> None:
    if not good.all():
        raise Unusable(path, f"of grasp '{names[~good][0]}' {what}")
