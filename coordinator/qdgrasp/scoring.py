"""Scoring: what hand poses are worth, as arrays in and arrays out."""

from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp.evaluations import Evaluations
from qdgrasp.places import HERE, Place
from qdgrasp.scenery import Scenery
from qdgrasp_coordinator.counts.poses import Names, Poses, scores
from qdgrasp_protocol.genome import GIVEN
from qdgrasp_protocol.trials import trials

KEYWORDS = Names("positions", "quaternions_xyzw", "synergies", "spreads")


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
    poses = Poses.of(KEYWORDS, positions, quaternions_xyzw, synergies, spreads)
    evaluations = Evaluations(prior=GIVEN, place=place, **scenery)
    genomes = poses.genomes(evaluations.scene)
    place.check_hands()
    with evaluations:
        rows = evaluations.journal(genomes)
    return scores(rows, trials(evaluations.spec.protocol))
