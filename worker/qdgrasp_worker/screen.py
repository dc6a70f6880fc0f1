"""The screen: which pose of each genome is simulated, as far as that is known without the simulator."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.overlap import OverlapFilter
from qdgrasp_worker.ranking import Ranking, are_choosy, scores
from qdgrasp_worker.solid import Solid
from qdgrasp_worker.swath import Closing, Swaths


@dataclass(frozen=True)
class Shortlist:
    """The candidates of one genome, by their places in the batch."""

    first: int
    """What stands for the genome where none is simulated: the first that is a pose, or the first."""
    poses: int
    """How many of them are poses; 0: a dead end."""
    ranked: list[int]
    """The poses that do not surely overlap, and promise enough, in the order in which they are tried."""
    otherwise: Outcome
    """What it means where none of them is simulated."""

    @property
    def is_choice(self) -> bool:
        """Whether one of several poses is to be found."""
        return self.poses > 1


class Screen:
    """What is known of a scene's poses before they are simulated.

    Parameters
    ----------
    closing
        How the hand closes on nothing.
    follows_free_joints
        Whether the test for overlap has the free joints where the grasp has them, or open.
    filters
        Whether poses that surely overlap are left out; it changes no result.
    """

    def __init__(
        self, scene: Scene, solid: Solid, closing: Closing, *, follows_free_joints: bool, filters: bool = True
    ) -> None:
        self._scene = scene
        self._closing = closing
        self._follows = follows_free_joints
        self._filters = filters
        self._solid = solid

    def __call__(
        self, grasps: Grasps, trials: NDArray[np.uint16], wanted: NDArray[np.bool_]
    ) -> tuple[list[Shortlist], NDArray[np.float32]]:
        """The shortlists of a batch, one for each genome, and the features (poses, f) of what is ranked.

        Parameters
        ----------
        trials
            (n,): beyond 0 a genome's only pose is disturbed and not filtered; of several one is chosen first.
        wanted
            (n,): the genomes that are looked at; the others have empty lists.
        """
        is_pose = ~grasps.dead_ends & wanted[grasps.rows]
        (poses,) = np.nonzero(is_pose)
        is_choice = np.bincount(grasps.rows[poses], minlength=len(trials)) > 1
        (nominal,) = np.nonzero(is_pose & (is_choice | (trials == 0))[grasps.rows])
        left = np.setdiff1d(poses, self._overlap(grasps, nominal)) if self._filters else poses
        features, order = self._rank(grasps, left)
        choosy = are_choosy(grasps.weights)
        return shortlists(grasps, poses, order, np.where(choosy, Outcome.DEAD_END, Outcome.OVERLAP)), features

    def _rank(self, grasps: Grasps, left: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """The features (poses, f), and those of `left` that promise enough, the best of each genome first."""
        features = np.zeros((len(grasps), grasps.weights.shape[1]), dtype=np.float32)
        if not features.shape[1]:
            return features, left
        features[left] = self._ranking.features(grasps, left)
        rows = grasps.rows[left]
        promised = scores(features[left], grasps.weights[rows])
        best_first = np.lexsort([-promised, rows])
        is_enough = (promised >= 0.0) | ~are_choosy(grasps.weights)[rows]
        return features, left[best_first[is_enough[best_first]]]

    @cached_property
    def _overlap(self) -> OverlapFilter:
        return OverlapFilter(self._scene.gripper, self._solid, follows_free_joints=self._follows)

    @cached_property
    def _ranking(self) -> Ranking:
        gripper = self._scene.gripper
        return Ranking(gripper, self._solid, Swaths(gripper, self._closing))


def shortlists(
    grasps: Grasps, poses: NDArray[np.intp], order: NDArray[np.intp], otherwise: NDArray[np.integer]
) -> list[Shortlist]:
    """A list for each genome, of the `poses` among a batch of grasps and the `order` in which to try them."""
    genomes = np.arange(len(grasps.weights))
    counts = np.bincount(grasps.rows[poses], minlength=len(genomes))
    first = np.searchsorted(grasps.rows, genomes)
    is_alive = counts > 0
    first[is_alive] = poses[np.searchsorted(grasps.rows[poses], genomes[is_alive])]
    ends = np.searchsorted(grasps.rows[order], genomes, side="right")
    ranked = [places.tolist() for places in np.split(order, ends)[:-1]]
    outcomes = [Outcome(number) for number in otherwise.tolist()]
    return [Shortlist(*each) for each in zip(first.tolist(), counts.tolist(), ranked, outcomes, strict=True)]
