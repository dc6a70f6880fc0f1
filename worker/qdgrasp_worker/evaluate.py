"""Evaluate: a batch of genomes in, a batch of result rows out. Decode, place, close, shake, report."""

from dataclasses import dataclass
from typing import Self

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
from qdgrasp_worker.surface import Surface
from qdgrasp_worker.world import World

REASON_LENGTH = 200


@dataclass(frozen=True)
class Evaluation:
    """What a batch found."""

    rows: Rows
    """(n,): trial, genome and all result columns; result columns of failed rows hold zeros."""
    failures: list[tuple[int, str]]
    """The rows on which the simulator failed, by their place in the batch, with the reason."""


class Evaluator:
    """One Bullet world for one scene; a context manager that leaves it.

    An evaluation is a pure function of scene, genome and trial: not of what was evaluated before, of the
    batch, or of the process (docs/reproducibility.md).

    Raises
    ------
    AssetError
        Bullet cannot load the scene.
    UnknownName
        There is no such evaluation protocol.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.protocol not in PROTOCOLS:
            raise UnknownName("protocol", scene.protocol, PROTOCOLS)
        self.scene = scene
        self._protocol = PROTOCOLS[scene.protocol]
        self._surface = Surface(scene)
        self._decoders: dict[str, Decoder] = {}
        self._world = World(scene)

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
        found = [reason or self._verdict(grasps, i, int(trials[i])) for i, reason in enumerate(refused)]
        verdicts = {i: verdict for i, verdict in enumerate(found) if isinstance(verdict, Verdict)}
        fill(rows, grasps, verdicts)
        failures = [(i, reason[:REASON_LENGTH]) for i, reason in enumerate(found) if isinstance(reason, str)]
        return Evaluation(rows, failures)

    def _decoder(self, prior: str) -> Decoder:
        if prior not in self._decoders:
            self._decoders[prior] = Decoder(self.scene, prior, self._surface)
        return self._decoders[prior]

    def _verdict(self, grasps: Grasps, i: int, trial: int) -> Verdict | str:
        """What an episode finds, or the reason why it failed; the next one starts in a new world then."""
        pose = grasps[i]
        if grasps.dead_ends[i]:
            return Verdict(Outcome.DEAD_END, pose.joints)
        try:
            return Episode(self._world, self._protocol).run(self._protocol.trial(pose, trial))
        except Exception as error:  # noqa: BLE001  # whatever failed, it is this row's result and no other's
            self._world.close()
            self._world = World(self.scene)
            return f"{type(error).__name__}: {error}"


def refusals(
    genomes: NDArray[np.float32], trials: NDArray[np.uint16], grasps: Grasps, last: int
) -> list[str]:
    """For each row the reason why it cannot be evaluated; empty where it can. `last` is the last trial."""
    finite = np.isfinite(genomes).all(axis=1) & grasps.are_finite
    reasons = {
        "the genome stands for no pose: it holds, or leads to, numbers that are not finite": ~finite,
        f"this evaluation protocol has no trial {f'above {last}' if last else 'but 0'}": trials > last,
    }
    return [next((reason for reason, holds in reasons.items() if holds[i]), "") for i in range(len(trials))]


def fill(rows: Rows, grasps: Grasps, verdicts: dict[int, Verdict]) -> None:
    """Write the result columns of those rows that have a verdict, by their place in the batch."""
    if not verdicts:
        return
    places, found = list(verdicts), list(verdicts.values())
    positions = grasps.positions[places]
    columns = {
        "outcome": [verdict.outcome for verdict in found],
        "fitness": [verdict.fitness for verdict in found],
        "proposals": 1,
        "descriptor": positions,
        "base_to_object": np.concatenate([positions, grasps.quaternions[places]], axis=1),
        "joints": [verdict.joints for verdict in found],
        "surface_point": grasps.surface_points[places],
        "nu": grasps.nu[places],
        "contacts": [verdict.contacts for verdict in found],
        "penetration": [verdict.penetration for verdict in found],
    }
    for name, values in columns.items():
        rows[name][places] = values
