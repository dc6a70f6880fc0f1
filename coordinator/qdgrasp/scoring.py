"""Scoring: what hand poses are worth, as arrays in and arrays out."""

from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp.evaluations import Evaluations
from qdgrasp.places import HERE, Place
from qdgrasp.scenery import Scenery
from qdgrasp_coordinator.counts.poses import Poses, scores
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.genome import GIVEN, NO_SYNERGY
from qdgrasp_protocol.trials import trials

SHORTEST = 1e-6
"""Quaternions that are shorter name no rotation."""


def evaluate(
    positions: ArrayLike,
    quaternions_xyzw: ArrayLike,
    *,
    synergies: ArrayLike | None = None,
    spreads: ArrayLike | None = None,
    place: Place = HERE,
    **scenery: Unpack[Scenery],
) -> dict[str, NDArray[np.generic]]:
    """Score hand poses; what `qdgrasp evaluate` does, for arrays.

    Parameters
    ----------
    positions
        (n, 3) [m]: of the hand's root link, in the object's centre-of-mass frame.
    quaternions_xyzw
        (n, 4): of the same; brought to length one.
    synergies
        (n,): labels of the synergies that close, -1 for none; None: none.
    spreads
        (n, k): positions of the free joints [rad], NaN for open; None: open.
    place
        Where it is done.
    **scenery
        `gripper` and `object`, and where need be `mass`, `scale`, `friction`, `protocol`, `surface_seed`.

    Returns
    -------
    scores
        Arrays of n by name: `valid`, `touched`, `success` (bool), `fitness` (0 to 2), `outcome` (`Outcome`),
        `base_position`, `base_quaternion_xyzw`, `joints` (n, j), `contacts`, `penetration` [m]; with a
        protocol that has trials also `eta`.

    Raises
    ------
    InputError
        A name that is not known, a value that cannot be, or a file that cannot be used.

    Examples
    --------
    >>> scores = qdgrasp.evaluate([[0.0, 0.0, 0.15]], [[1.0, 0.0, 0.0, 0.0]], gripper="panda", object="mug")
    >>> scores["success"], scores["fitness"]
    (array([ True]), array([2], dtype=uint8))
    """
    poses = _poses(positions, quaternions_xyzw, synergies, spreads)
    if not len(poses):
        raise InputError("There are no poses to score.")
    with Evaluations(prior=GIVEN, place=place, **scenery) as evaluations:
        if not evaluations.scene.gripper.synergies and (poses.synergies != NO_SYNERGY).any():
            raise ImpossibleValue("synergies", int(poses.synergies.max()), "-1, for the hand has none")
        rows = evaluations.journal(poses.genomes(evaluations.scene))
    return scores(rows, trials(evaluations.spec.protocol))


def _poses(
    positions: ArrayLike, quaternions: ArrayLike, synergies: ArrayLike | None, spreads: ArrayLike | None
) -> Poses:
    places = _array("positions", positions, (None, 3))
    n = len(places)
    turns = _array("quaternions_xyzw", quaternions, (n, 4))
    if (np.linalg.norm(turns, axis=1) < SHORTEST).any():
        raise ImpossibleValue("quaternions_xyzw", "one of length zero", "rotations")
    labels = np.full(n, NO_SYNERGY) if synergies is None else _array("synergies", synergies, (n,))
    if (labels != np.rint(labels)).any():
        raise ImpossibleValue("synergies", float(labels[labels != np.rint(labels)][0]), "integers")
    free = np.full((n, 0), np.nan) if spreads is None else _numbers("spreads", spreads, f"({n}, k)")
    if free.ndim != 2 or len(free) != n or np.isinf(free).any():
        raise ImpossibleValue("spreads", free.shape, f"numbers of shape ({n}, k)")
    return Poses(places, turns, labels.astype(np.int64), free)


def _array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Finite numbers of a shape, in which None stands for n."""
    expected = "({})".format(", ".join("n" if wanted is None else str(wanted) for wanted in shape))
    array = _numbers(name, values, expected)
    fits = len(array.shape) == len(shape) and all(
        wanted in (None, came) for wanted, came in zip(shape, array.shape, strict=True)
    )
    if not fits or not np.isfinite(array).all():
        raise ImpossibleValue(name, array.shape, f"finite numbers of shape {expected}")
    return array


def _numbers(name: str, values: ArrayLike, shape: str) -> NDArray[np.float64]:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be numbers of shape {shape}; {error}.") from None
