"""Interface of custom evaluators: hands in, verdicts out, as arrays, without any simulator."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import QdgraspError
from qdgrasp_protocol.rows import Outcome


@dataclass(frozen=True)
class Hands:
    """Hands that are to close on the object of a scene: n of them, each a row of every array."""

    base_to_object: NDArray[np.float32]
    """(n, 7): hand's root link, object's centre-of-mass frame: x y z [m], qx qy qz qw.

    In a trial above 0 it is relative to the disturbed object, without the approach.
    """
    joints: NDArray[np.float32]
    """(n, j): finger joints that the hand starts from [rad or m], in the gripper's order."""
    synergies: NDArray[np.int64]
    """(n,): labels of the synergies that close; -1: all driven joints do."""
    frictions: NDArray[np.float64]
    """(n, 2): the object's rolling and spinning friction."""
    trials: NDArray[np.uint16]
    """(n,): 0 is the nominal evaluation, 1 and up are disturbed ones."""
    surface_points: NDArray[np.float32]
    """(n, 3) [m], same frame: points that the palm looks at; zeros where the prior aims at none."""
    prior: str
    """The prior that the genomes are decoded by."""
    genomes: NDArray[np.float32]
    """(n, d): the genomes of the hands."""

    def __len__(self) -> int:
        return len(self.base_to_object)

    def __getitem__(self, places: slice | NDArray[np.intp]) -> "Hands":
        arrays = {name: value[places] for name, value in vars(self).items() if name != "prior"}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Verdicts:
    """Verdicts on hands: n of them, in their order."""

    outcomes: NDArray[np.integer]
    """(n,): `Outcome.OVERLAP` to `Outcome.HELD`."""
    fitness: NDArray[np.floating] | None = None
    """(n,): disturbances survived; None: all of the protocol where held, 1 where shaken, else 0."""
    joints: NDArray[np.floating] | None = None
    """(n, j): finger joints at the grasp [rad or m]; None: those that the hand started from."""
    contacts: NDArray[np.integer] | None = None
    """(n,): finger links that touch the object; None: not known, zeros are recorded."""
    penetration: NDArray[np.floating] | None = None
    """(n,): deepest penetration [m], 0 or positive; None: not known, zeros are recorded."""

    def columns(self, hands: Hands, disturbances: int) -> dict[str, NDArray[np.generic]]:
        """The columns of rows that they fill; a BadVerdict if a shape or a value is impossible.

        `disturbances` is the number of them in one evaluation.
        """
        n, zeros = len(hands), np.zeros(len(hands))
        joints = hands.joints if self.joints is None else self.joints
        outcomes = _checked_array("outcomes", self.outcomes, (n,)).astype(np.int64)
        if not ((outcomes >= Outcome.OVERLAP) & (outcomes <= Outcome.HELD)).all():
            raise BadVerdict(f"outcomes must be {Outcome.OVERLAP:d} (OVERLAP) to {Outcome.HELD:d} (HELD)")
        survived = np.select([outcomes == Outcome.HELD, outcomes == Outcome.SHAKEN], [disturbances, 1])
        return {
            "outcome": outcomes,
            "fitness": _checked_array("fitness", survived if self.fitness is None else self.fitness, (n,)),
            "joints": _checked_array("joints", joints, (n, hands.joints.shape[1]), least=None),
            "contacts": _checked_array("contacts", zeros if self.contacts is None else self.contacts, (n,)),
            "penetration": _checked_array(
                "penetration", zeros if self.penetration is None else self.penetration, (n,)
            ),
        }


class BadVerdict(QdgraspError):
    """An evaluator's verdict has another shape than the hands, or holds impossible values."""


EvaluatorFn: TypeAlias = Callable[[Hands], Verdicts]
"""Returns verdicts on hands; the same for the same hands, independent of earlier calls."""
EvaluatorFactory: TypeAlias = Callable[[Scene], EvaluatorFn]
"""Makes a scene's evaluator: a class with `__init__(scene)` and `__call__`, or a function."""


def _checked_array(
    name: str, values: object, shape: tuple[int, ...], least: float | None = 0.0
) -> NDArray[np.generic]:
    array = np.asarray(values)
    if array.shape != shape or array.dtype.kind not in "biuf":
        raise BadVerdict(f"{name} must be numbers of shape {shape}, got {array.dtype} of {array.shape}")
    if not np.isfinite(array).all() or (least is not None and (array < least).any()):
        raise BadVerdict(f"{name} must be finite" + ("" if least is None else f" and at least {least:g}"))
    return array
