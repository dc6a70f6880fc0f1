"""The columns of a table of grasps: what Parquet and CSV have alike."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.exchange.frames import COM, Frame
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_protocol.outcome import Outcome

JOINT, PREGRASP = "joint.", "pregrasp."
"""What the columns of joints begin with; the joint's name follows."""
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
OUTCOMES = np.array([outcome.name.lower() for outcome in Outcome])


class Column(NamedTuple):
    """One column of the table."""

    name: str
    values: NDArray[np.generic]
    """(n,): numbers, NaN where there is none, or words, empty where there is none."""
    meaning: str


def columns(grasps: Grasps, frame: Frame) -> Iterator[Column]:
    """The columns of a table of grasps whose poses are told in a frame of the object."""
    rows, poses = grasps.rows, grasps.poses(frame)
    yield Column("number", grasps.numbers, "the row's number in the journal, from 0")
    yield Column("run", _words([source.run for source in grasps.sources], grasps.origins), "what found it")
    yield Column("generation", rows["generation"], "of the search")
    yield Column("index", rows["index"], "in the generation")
    yield Column("outcome", OUTCOMES[rows["outcome"]], "how the evaluation ended")
    yield Column("fitness", grasps.fitness, "shakes survived: 0, 1 or 2")
    yield Column("eta", grasps.eta, "estimated probability of transfer; none where it is not known")
    yield Column("confidence", grasps.confidence, "0 to 1, higher is better")
    for name, values in zip(POSE, poses.T, strict=True):
        meaning = "hand's root link in the object's frame [m]" if len(name) == 1 else "its quaternion"
        yield Column(name, values, meaning)
    for name, joint, start in zip(grasps.joint_names, grasps.joints.T, grasps.pregrasp.T, strict=True):
        yield Column(JOINT + name, joint, "joint at the grasp [rad or m]")
        yield Column(PREGRASP + name, start, "joint that the hand starts from [rad or m]")
    yield Column("synergy", _words(grasps.synergy_names, grasps.synergies), "what closes; none: all that can")
    aims = rows["surface_point"].astype(np.float64)
    aims = np.where(aims.any(axis=1, keepdims=True), aims + _shift(grasps, frame), np.nan)
    for name, values in zip("xyz", aims.T, strict=True):
        yield Column(f"aim_{name}", values, "surface point that was aimed at, object's frame [m]")
    yield Column("nu", rows["nu"], "angle of its normal to the direction to the hand [rad]")
    yield Column("contacts", rows["contacts"], "finger links that touch after closing")
    yield Column("penetration", rows["penetration"], "deepest after closing [m]")


def _words(words: list[str] | tuple[str, ...], labels: NDArray[np.int64]) -> NDArray[np.str_]:
    """Words by their labels; -1 stands for none."""
    return np.array([*words, ""])[labels]


def _shift(grasps: Grasps, frame: Frame) -> NDArray[np.float64]:
    return np.zeros(3) if frame == COM else np.array(grasps.scene.object.com_in_mesh)
