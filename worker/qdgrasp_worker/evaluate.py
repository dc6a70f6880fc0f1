"""Evaluate: a batch of genomes in, a batch of result rows out. Decode, place, close, shake, report."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import descriptors, layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_worker.decode import Decoder
from qdgrasp_worker.episode import Episode, Verdict
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.protocols import PROTOCOLS
from qdgrasp_worker.reach import EVERYWHERE, Everywhere, Reach
from qdgrasp_worker.screen import Screen, Shortlist
from qdgrasp_worker.solid import Solid
from qdgrasp_worker.surface import Surface
from qdgrasp_worker.trial import Trial
from qdgrasp_worker.world import World

REASON_LENGTH = 200


class Finding(NamedTuple):
    """What was found about a genome."""

    place: int
    """Its pose, in the batch of grasps."""
    verdict: Verdict
    proposals: int
    """How many poses were screened for it."""


@dataclass(frozen=True)
class Evaluation:
    """What a batch found."""

    rows: Rows
    """(n,): trial, genome and all result columns; result columns of failed rows hold zeros."""
    failures: list[tuple[int, str]]
    """The rows on which the simulator failed, by their place in the batch, with the reason."""


class Evaluator:
    """One Bullet world for one scene; a context manager that leaves it.

    `shortcuts` says whether poses that surely overlap, or surely miss, are spared the simulator, and whether
    closing ends when the object has left; they change no result
    (docs/decisions/0007-evaluation-shortcuts.md).

    An evaluation is a pure function of scene, genome and trial: not of what was evaluated before, of the
    batch, or of the process (docs/reproducibility.md).

    Raises
    ------
    AssetError
        Bullet cannot load the scene.
    UnknownName
        There is no such evaluation protocol.
    """

    def __init__(self, scene: Scene, *, shortcuts: bool = True) -> None:
        if scene.protocol not in PROTOCOLS:
            raise UnknownName("protocol", scene.protocol, PROTOCOLS)
        self.scene = scene
        self._protocol = PROTOCOLS[scene.protocol]
        self._surface = Surface(scene)
        self._decoders: dict[str, Decoder] = {}
        self._world = World(scene)
        self._shortcuts = shortcuts
        self._solid = Solid(scene)
        follows = self._protocol.free_joints_first
        self._screen = Screen(
            scene, self._solid, self._closing, follows_free_joints=follows, filters=shortcuts
        )

    @cached_property
    def _reach(self) -> Reach | Everywhere:
        if not self._shortcuts:
            return EVERYWHERE
        follows = self._protocol.free_joints_first
        return Reach(self.scene.gripper, self._solid, self._closing, follows_free_joints=follows)

    def _closing(self, posture: Sequence[float], synergy: int) -> list[list[float]]:
        """How the hand closes on nothing, in the world that there is."""
        return self._world.closing(posture, synergy)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave Bullet; closing twice is allowed."""
        self._world.close()

    def shape(self, prior: str) -> Shape:
        """How wide the rows of this scene are with genomes of `prior`."""
        return Shape(len(layout(self.scene, prior)), len(self.scene.gripper.joints), descriptors(prior))

    def evaluate(self, prior: str, genomes: NDArray[np.float32], trials: NDArray[np.uint16]) -> Evaluation:
        """Evaluate genomes (n, d) of `prior`, each in its trial (n,).

        Raises
        ------
        UnknownName
            There is no such prior.
        """
        grasps = self._decoder(prior)(genomes)
        rows = self.shape(prior).empty(len(genomes))
        rows["genome"], rows["trial"] = genomes, trials
        refused = refusals(genomes, trials, grasps, self._protocol.trials)
        wanted = np.array([not reason for reason in refused], dtype=bool)
        shortlists, features = self._screen(grasps, trials, wanted)
        found = [
            reason or self._find(grasps, shortlists[i], int(trials[i])) for i, reason in enumerate(refused)
        ]
        findings = {i: finding for i, finding in enumerate(found) if isinstance(finding, Finding)}
        fill(rows, grasps, features, findings)
        failures = [(i, reason[:REASON_LENGTH]) for i, reason in enumerate(found) if isinstance(reason, str)]
        return Evaluation(rows, failures)

    def _decoder(self, prior: str) -> Decoder:
        if prior not in self._decoders:
            self._decoders[prior] = Decoder(self.scene, prior, self._surface)
        return self._decoders[prior]

    def _find(self, grasps: Grasps, shortlist: Shortlist, trial: int) -> Finding | str:
        """What an episode finds, or the reason why it failed; the next one starts in a new world then."""
        if not shortlist.poses:
            return Finding(shortlist.first, Verdict(Outcome.DEAD_END, grasps[shortlist.first].joints), 1)
        try:
            place, verdict = self._try(grasps, shortlist, trial)
        except Exception as error:  # noqa: BLE001  # whatever failed, it is this row's result and no other's
            self._world.close()
            self._world = World(self.scene)
            return f"{type(error).__name__}: {error}"
        return Finding(place, verdict, shortlist.poses)

    def _try(self, grasps: Grasps, shortlist: Shortlist, trial: int) -> tuple[int, Verdict]:
        """The best candidate that is worth it and does not overlap, or the first; what an episode finds.

        It is chosen by trial 0, so that all trials of a genome disturb the same pose.
        """
        episode = Episode(self._world, self._protocol, self._reach, stops_early=self._shortcuts)
        for place in shortlist.ranked:
            pose = grasps[place]
            if trial and shortlist.is_choice and episode.overlaps(Trial(pose)):
                continue
            verdict = episode.run(self._protocol.trial(pose, trial))
            if trial or verdict.outcome is not Outcome.OVERLAP:
                return place, verdict
        return shortlist.first, Verdict(shortlist.otherwise, grasps[shortlist.first].joints)


def refusals(
    genomes: NDArray[np.float32], trials: NDArray[np.uint16], grasps: Grasps, last: int
) -> list[str]:
    """For each row the reason why it cannot be evaluated; empty where it can. `last` is the last trial."""
    finite = np.asarray(np.isfinite(genomes).all(axis=1))
    np.logical_and.at(finite, grasps.rows, grasps.are_finite)
    reasons = {
        "the genome stands for no pose: it holds, or leads to, numbers that are not finite": ~finite,
        f"this evaluation protocol has no trial {f'above {last}' if last else 'but 0'}": trials > last,
    }
    return [next((reason for reason, holds in reasons.items() if holds[i]), "") for i in range(len(trials))]


def fill(rows: Rows, grasps: Grasps, features: NDArray[np.float32], findings: dict[int, Finding]) -> None:
    """Write the result columns of those rows that have a finding, by their place in the batch.

    The `features` (poses, f) of a pose follow its position in the descriptor, where it was simulated.
    """
    if not findings:
        return
    places, found = list(findings), [finding.verdict for finding in findings.values()]
    taken = [finding.place for finding in findings.values()]
    is_simulated = np.array([[verdict.outcome.is_simulated] for verdict in found])
    positions = grasps.positions[taken]
    columns = {
        "outcome": [verdict.outcome for verdict in found],
        "fitness": [verdict.fitness for verdict in found],
        "proposals": [finding.proposals for finding in findings.values()],
        "descriptor": np.concatenate([positions, np.where(is_simulated, features[taken], 0.0)], axis=1),
        "base_to_object": np.concatenate([positions, grasps.quaternions[taken]], axis=1),
        "joints": [verdict.joints for verdict in found],
        "surface_point": grasps.surface_points[taken],
        "nu": grasps.nu[taken],
        "contacts": [verdict.contacts for verdict in found],
        "penetration": [verdict.penetration for verdict in found],
    }
    for name, values in columns.items():
        rows[name][places] = values
