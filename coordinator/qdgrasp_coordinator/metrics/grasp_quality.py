"""Settled pose, motion of the object and margin of recorded grasps, and limits to them.

Rows are those of a journal or of success pages. Runs of version 0.1.0 recorded no settled pose: their motion
and margin are NaN, which no limit admits.
"""

from dataclasses import dataclass, fields

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, conjugate, dot, rotate
from qdgrasp_assets.scene import Scene, SceneObject
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import CONTACT_VALUES, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import counted

MM = 1e-3
NOT_SETTLED = "where hands settled is not recorded: drawn as commanded"
TORSION = 0.005  # Of finger and object [m]: the radius of a fingertip's patch, as `physical` takes it


def settled_mask(rows: Rows) -> NDArray[np.bool_]:
    """(n,): True where the settled pose is recorded."""
    return np.asarray(rows["settled"].any(axis=1))


def settled_poses(rows: Rows) -> Floats:
    """(n, 7): the hand's base link after closing, CoM frame; as commanded where unknown."""
    poses, known = rows["base_to_object"].astype(np.float64), settled_mask(rows)
    if known.any():  # rows of version 0.1.0 have no room for it
        poses[known] = rows["settled"][known]
    return poses


def object_motion(rows: Rows) -> Floats:
    """(n, 2): how far the object moved in the hand while it closed [m], and turned [rad].

    The way of its centre of mass, in the hand's frame. NaN where it is not known.
    """
    before, after = rows["base_to_object"].astype(np.float64), settled_poses(rows)
    first, last = (rotate(conjugate(poses[:, 3:]), -poses[:, :3]) for poses in (before, after))
    cosines = np.abs((before[:, 3:] * after[:, 3:]).sum(axis=1)).clip(0.0, 1.0)
    moved = np.column_stack([np.sqrt(dot(last - first, last - first)), 2.0 * np.arccos(cosines)])
    return np.where(settled_mask(rows)[:, None], moved, np.nan)


def contact_values(rows: Rows) -> Floats:
    """(n, k, 7): point [m], normal into the object and force [N] of each contact, CoM frame."""
    slots = rows.dtype["contact_links"].shape[0]
    values: Floats = rows["contact_points"].astype(np.float64).reshape(len(rows), slots, CONTACT_VALUES)
    return values


def recorded_margins(rows: Rows, body: SceneObject) -> Floats:
    """(n,): the Ferrari-Canny margin of contacts (`grasp_margin`); NaN: none were recorded."""
    from qdgrasp_coordinator.metrics.grasp_margin import grasp_margins  # scipy takes its time

    known, found = settled_mask(rows), np.full(len(rows), np.nan)
    if known.any():
        values = contact_values(rows)
        found[known] = grasp_margins(
            values[known, :, :3],
            values[known, :, 3:6],
            rows["contact_links"][known] > 0,
            friction=body.lateral_friction,
            torsion=TORSION,
            radius=body.radius,
        )
    return found


def takes_held(spec: RunSpec, min_fitness: float | None = None) -> bool:
    """Return whether grasps that hold are taken: by default if `physical` judges a pose."""
    return min_fitness is None and spec.nominal_protocol == "physical"


def taken_mask(rows: Rows, spec: RunSpec, min_fitness: float | None) -> NDArray[np.bool_]:
    """(n,): True for rows of the least fitness that is asked for, or more.

    None: where `takes_held` those whose outcome is `HELD`, elsewhere those of fitness 1 or more.
    """
    if takes_held(spec, min_fitness):
        return np.asarray(rows["outcome"] == Outcome.HELD)
    return np.asarray(rows["fitness"] >= (1 if min_fitness is None else min_fitness))


@dataclass(frozen=True)
class GraspLimits:
    """Limits to what closing did; None: no limit. Raises ImpossibleValue for a negative one."""

    max_penetration: float | None = None
    """[mm]."""
    max_motion: float | None = None
    """Of the object in the hand [mm]."""
    min_margin: float | None = None
    min_links: int | None = None
    """Finger links that touch."""

    def __post_init__(self) -> None:
        for name, value in self.given.items():
            if not 0 <= value < np.inf:
                raise ImpossibleValue(name, value, "a number not less than 0")

    @property
    def given(self) -> dict[str, float]:
        """The limits that there are, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    def admitted(self, rows: Rows, scene: Scene) -> NDArray[np.bool_]:
        """(n,): True for rows within all limits; margins are computed last, for the others' rows."""
        mask = np.ones(len(rows), dtype=bool)
        if self.max_penetration is not None:
            mask &= rows["penetration"] <= self.max_penetration * MM
        if self.max_motion is not None:
            mask &= object_motion(rows)[:, 0] <= self.max_motion * MM
        if self.min_links is not None:
            mask &= rows["contacts"] >= self.min_links
        if self.min_margin is not None:
            mask[mask] = recorded_margins(rows[mask], scene.object) >= self.min_margin
        return mask

    def reason(self, rows: Rows, scene: Scene) -> str:
        """Say how many of some rows each limit admits, for a person."""
        if not settled_mask(rows).any() and {"max_motion", "min_margin"} & self.given.keys():
            return "motion and margin are not known, the run was recorded before they were"
        alone = {name: msgspec.convert({name: value}, GraspLimits) for name, value in self.given.items()}
        counts = {name: int(limit.admitted(rows, scene).sum()) for name, limit in alone.items()}
        words = (f"--{name.replace('_', '-')} {self.given[name]:g} admits {n}" for name, n in counts.items())
        return f"of {counted(len(rows), 'grasp')} {', '.join(words)}"


NO_LIMITS = GraspLimits()
