"""Evaluators that take a whole batch in lockstep, in worlds that a device simulates.

Decoding, screening and the choice among candidates are those of `Evaluator`. Rows whose worlds overflowed
their buffers, or whose numbers are not finite, are evaluated one by one in MuJoCo.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import cast

import numpy as np

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.candidate_ranking import Shortlist
from qdgrasp_worker.decoder import DecodedGrasps
from qdgrasp_worker.engines.lockstep import BatchWorlds, BufferSizes, LockstepEpisodes
from qdgrasp_worker.engines.mujoco_simulation import Simulation
from qdgrasp_worker.engines.mujoco_world import MujocoPhysicalWorld
from qdgrasp_worker.episode import EpisodeResult, approach_path
from qdgrasp_worker.evaluation_protocols import TrialSetup
from qdgrasp_worker.evaluator import Evaluator, GenomeResult
from qdgrasp_worker.physical_episode import PhysicalEpisode

LEAST_BUFFERS, BUFFER_FACTOR = BufferSizes(32, 64), 2  # Least use, and factor from use to size
BUFFER_POSES, BUFFER_PRIOR = 128, "contact"  # Poses that are simulated to measure the use


def next_power(number: int) -> int:
    """The least power of two that is not below a number."""
    return 1 << (number - 1).bit_length()


class LockstepEvaluator(Evaluator):
    """Evaluates batches in worlds that `make_worlds` makes of a scene's models."""

    def __init__(
        self,
        scene: Scene,
        make_worlds: Callable[[Simulation, BufferSizes], BatchWorlds],
        *,
        shortcuts: bool = True,
    ) -> None:
        super().__init__(scene, shortcuts=shortcuts)
        self._mujoco = cast(MujocoPhysicalWorld, self._worlds[0])
        self.buffers = self._measured_buffers()
        """Sizes of the worlds' buffers."""
        models = self._mujoco.fixed, self._mujoco.free
        self._fixed, self._free = (make_worlds(model, self.buffers) for model in models)
        self.redone = 0
        """Rows that were evaluated again, one by one."""

    def _measured_buffers(self) -> BufferSizes:
        """Twice what poses use in MuJoCo, as powers of two; the same for the same scene.

        Overlapping poses are not stepped: their contacts count in the mean, and make no constraints.
        """
        genes = len(layout(self.scene, BUFFER_PRIOR))
        genomes = np.random.default_rng(0).uniform(-1.0, 1.0, (BUFFER_POSES, genes)).astype(np.float32)
        grasps = self._decoder(BUFFER_PRIOR)(genomes)
        episode = PhysicalEpisode(self._mujoco, self._protocol)
        most, overlapping = LEAST_BUFFERS, [0]
        for i in np.flatnonzero(~grasps.dead_ends & grasps.are_finite).tolist():
            if episode.run(TrialSetup(grasps[i])).outcome is Outcome.OVERLAP:
                overlapping.append(self._mujoco.free.buffers_used[0])
            else:
                used = self._mujoco.fixed.buffers_used, self._mujoco.free.buffers_used
                most = BufferSizes(*map(max, most, *used))
        contacts = max(most.contacts, round(sum(overlapping) / len(overlapping)))
        return BufferSizes(next_power(BUFFER_FACTOR * contacts), next_power(BUFFER_FACTOR * most.constraints))

    def _find_all(
        self, grasps: DecodedGrasps, shortlists: list[Shortlist], trials: list[int], rows: list[int]
    ) -> dict[int, GenomeResult | str]:
        """Return the results of these rows of a batch, or the reasons of failures."""
        posed = [row for row in rows if shortlists[row].poses]
        chosen = self._choose(grasps, {row: shortlists[row] for row in posed}, trials)
        setups = {
            row: self._protocol.trial(grasps[place], trials[row])
            for row, place in chosen.items()
            if place is not None
        }
        results = self._results(setups, {row for row in setups if trials[row]})
        found: dict[int, GenomeResult | str] = {}
        for row, place in chosen.items():
            listed = shortlists[row]
            if place is None:
                none = EpisodeResult(listed.fallback, grasps[listed.first].joints)
                found[row] = GenomeResult(listed.first, none, listed.poses)
            elif row in results:
                found[row] = GenomeResult(place, results[row], listed.poses)
        self.redone += sum(row not in found for row in posed)
        return {row: found.get(row) or self._find(grasps, shortlists[row], trials[row]) for row in rows}

    def _choose(
        self, grasps: DecodedGrasps, shortlists: dict[int, Shortlist], trials: list[int]
    ) -> dict[int, int | None]:
        """Find the first candidate of each row that does not overlap; None: all of them do.

        In each round the next candidate of every row is tested. Rows without a sure answer are left out.
        """
        chosen: dict[int, int | None] = {}
        waiting = {row: iter(listed.ranked) for row, listed in shortlists.items()}
        while waiting:
            tried = {row: next(places, None) for row, places in waiting.items()}
            tested = {
                row: TrialSetup(grasps[place])
                for row, place in tried.items()
                if place is not None and (not trials[row] or shortlists[row].is_choice)
            }
            overlaps = self._overlaps(tested)
            chosen |= {
                row: place for row, place in tried.items() if row not in tested or overlaps.get(row) is False
            }
            waiting = {row: waiting[row] for row, overlapping in overlaps.items() if overlapping}
        return chosen

    def _results(self, setups: dict[int, TrialSetup], disturbed: set[int]) -> dict[int, EpisodeResult]:
        """The results of setups by their rows, without those that are not to be trusted.

        Setups of rows that are not `disturbed` are known not to overlap.
        """
        results: dict[int, EpisodeResult] = {}
        setups = self._approached(setups)
        overlaps = self._overlaps({row: setup for row, setup in setups.items() if row in disturbed})
        for row in disturbed & setups.keys():
            if overlaps.get(row) is not False:
                setup = setups.pop(row)
                if row in overlaps:
                    results[row] = EpisodeResult(Outcome.OVERLAP, setup.pose.joints)
        for row, setup in list(setups.items()):
            self._contact_filter.prepare(setup.pose.synergy)
            if self._contact_filter.misses(setup.pose):
                results[row] = EpisodeResult(Outcome.MISSED, setup.pose.joints)
                del setups[row]
        if setups:
            episodes = self._episodes(setups)
            found = zip(setups, episodes.run(), episodes.is_trusted, strict=True)
            results |= {row: result for row, result, is_trusted in found if is_trusted}
        return results

    def _approached(self, setups: dict[int, TrialSetup]) -> dict[int, TrialSetup]:
        """Setups with the hands where they stop on their approach, as in `Episode`.

        Setups without a sure answer about an overlap on the way are left out.
        """
        axis, reach = self._mujoco.approach_axis, self._mujoco.reach
        paths = {
            row: [replace(setup, pose=pose) for pose in approach_path(setup.pose, axis, reach)]
            for row, setup in setups.items()
            if setup.approaches
        }
        stops = {row: setups[row] if row not in paths else paths[row][0] for row in setups}
        on_way = {row: iter(path) for row, path in paths.items()}
        while on_way:
            come = {row: setup for row, path in on_way.items() for setup in islice(path, 1)}
            overlaps = self._overlaps(come)
            stops |= {row: come[row] for row, overlapping in overlaps.items() if not overlapping}
            for row in come.keys() - overlaps.keys():
                del stops[row]
            on_way = {row: on_way[row] for row, overlapping in overlaps.items() if not overlapping}
        return stops

    def _overlaps(self, setups: dict[int, TrialSetup]) -> dict[int, bool]:
        """Return whether open hands are inside the object; rows that are not sure are left out."""
        if not setups:
            return {}
        episodes = self._episodes(setups)
        found = zip(setups, episodes.overlaps().tolist(), episodes.is_trusted, strict=True)
        return {row: overlapping for row, overlapping, is_trusted in found if is_trusted}

    def _episodes(self, setups: dict[int, TrialSetup]) -> LockstepEpisodes:
        return LockstepEpisodes(self._mujoco, self._fixed, self._free, [*setups.values()])
