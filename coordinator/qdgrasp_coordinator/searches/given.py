"""Given poses: one pass over poses that are scored as they are (prior "given")."""

import numpy as np

from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec


class Given:
    """Asks given poses in their order, at most `population` in a generation, each once.

    Parameters
    ----------
    poses
        (n, d) float32, laid out as `layout(scene, GIVEN)` says; not confined to [-1, 1].
    population
        The most rows in a generation.
    """

    def __init__(self, poses: Genomes, population: int) -> None:
        self._poses = poses
        self._population = population

    def ask(self, generation: int) -> Genomes:
        """The next poses; no rows when all have been asked."""
        first = generation * self._population
        return self._poses[first : first + self._population]

    def tell(self, generation: int, rows: Rows) -> None:
        """Nothing is learned."""


def check(spec: RunSpec) -> None:
    """Whether a spec has poses, finite ones, and no greater budget than these.

    Raises
    ------
    ImpossibleValue
        It has not.
    """
    if spec.poses is None:
        raise ImpossibleValue("poses", None, f"lists of numbers for method '{spec.method}'")
    if spec.evaluations > len(spec.poses):
        raise ImpossibleValue(
            "evaluations", spec.evaluations, f"at most {len(spec.poses)}, one for each pose"
        )
    if not all(np.isfinite(pose).all() for pose in spec.poses):
        raise ImpossibleValue("poses", "one with a number that is not finite", "lists of finite numbers")


def given(spec: RunSpec, genes: int) -> Given:
    """The search over the poses of a spec.

    Raises
    ------
    ImpossibleValue
        See `check`; or a pose has not `genes` numbers.
    """
    check(spec)
    poses = spec.poses or ()
    if wrong := {len(pose) for pose in poses} - {genes}:
        expected = f"lists of {genes} numbers for this hand: the pose, synergy and free joints"
        raise ImpossibleValue("poses", f"one of {wrong.pop()}", expected)
    return Given(np.array(poses, dtype=np.float32), spec.population)
