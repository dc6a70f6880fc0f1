"""Evaluators: a batch of genomes in, rows out. Decode, place, close, shake, report.

A worker keeps one evaluator for each scene that it served lately.
"""

import gc
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.geometry.rotation import dot
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import DEVICE_ENGINE, Device, engine_names
from qdgrasp_worker.contact_filter import ContactFilter
from qdgrasp_worker.decoder import DecodedGrasps, Decoder, HandPose
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.episode import EpisodeResult, ShakenEpisode, outcome_of
from qdgrasp_worker.evaluation_protocols import EvaluationProtocol, TrialSetup, scene_protocol
from qdgrasp_worker.physical_episode import LiftEpisode, PhysicalEpisode, PhysicalWorld
from qdgrasp_worker.pose_filters import ObjectSolid, PoseFilters
from qdgrasp_worker.world import GraspContact, ShakenWorld

DEVICE_MODULE = "qdgrasp_worker.engines.warp_worlds"
REASON_LENGTH = 200


@dataclass(frozen=True)
class Evaluation:
    """Results of a batch."""

    rows: Rows
    """(n,): trial, genome and all result columns; result columns of failed rows hold zeros."""
    failures: list[tuple[int, str]]
    """The rows on which the simulator failed, by their place in the batch, with the reason."""


ROWS_AT_ONCE = 16  # Rows evaluated at once; evaluation is pure, so slicing changes nothing


class BatchEvaluator(ABC):
    """Evaluates batches of genomes in one scene; UnknownName if its protocol does not exist.

    `shortcuts` says whether poses that surely overlap are refused before any is simulated.
    """

    at_once = ROWS_AT_ONCE
    """The most rows that it is given at once."""
    weight = 1
    """Memory that it takes, in worlds of Bullet."""

    def __init__(self, scene: Scene, *, shortcuts: bool) -> None:
        self.scene = scene
        self._protocol = scene_protocol(scene)
        self._surface = ObjectSurface(scene)
        self._object = ObjectSolid(scene)
        follows = self._protocol.free_joints_first
        self._pose_filters = PoseFilters(
            scene, self._object, follows_free_joints=follows, shortcuts=shortcuts
        )
        self._decoders: dict[str, Decoder] = {}

    @abstractmethod
    def close(self) -> None:
        """Free its resources; closing twice is allowed."""

    def evaluate(self, prior: str, genomes: NDArray[np.float32], trials: NDArray[np.uint16]) -> Evaluation:
        """Evaluate genomes (n, d) of `prior`, each in its trial (n,); UnknownName for the prior."""
        grasps, rows = self._decoder(prior)(genomes), self.shape(prior).empty(len(genomes))
        rows["genome"], rows["trial"] = genomes, trials
        reasons = row_refusals(genomes, trials, grasps, self._protocol.trials)
        wanted = np.isin(np.arange(len(rows)), [*reasons], invert=True)
        known = self._pose_filters(grasps, trials, wanted)
        fill_rows(rows, grasps, {i: EpisodeResult(outcome, grasps[i].joints) for i, outcome in known.items()})
        if places := [i for i in np.flatnonzero(wanted).tolist() if i not in known]:
            reasons |= self._judge(prior, rows, grasps, places)
        return Evaluation(rows, [(i, reasons[i][:REASON_LENGTH]) for i in sorted(reasons)])

    @abstractmethod
    def _judge(self, prior: str, rows: Rows, grasps: DecodedGrasps, places: list[int]) -> dict[int, str]:
        """Fill the rows at some places with results; return the reasons of failures by place."""

    def shape(self, prior: str) -> RowShape:
        """The widths of the rows of this scene with genomes of `prior`."""
        genes, joints = len(layout(self.scene, prior)), len(self.scene.gripper.joints)
        return RowShape(genes, joints, self.scene.contact_slots)

    def _decoder(self, prior: str) -> Decoder:
        if prior not in self._decoders:
            self._decoders[prior] = Decoder(self.scene, prior, self._surface)
        return self._decoders[prior]


class Evaluator(BatchEvaluator):
    """A world for one scene in each of its engines; a context manager that leaves them.

    `shortcuts` says whether poses that surely overlap, or surely miss, are left unsimulated; they change no
    result (docs/decisions/0007-evaluation-shortcuts.md).

    An evaluation is a pure function of scene, genome and trial: not of what was evaluated before, of the
    batch, or of the process (docs/reproducibility.md). An AssetError if the engine cannot load the scene.
    """

    def __init__(self, scene: Scene, *, shortcuts: bool = True) -> None:
        super().__init__(scene, shortcuts=shortcuts)
        self._worlds = self._make_worlds()
        self._shortcuts = shortcuts

    @cached_property
    def _contact_filter(self) -> ContactFilter | None:
        if not self._shortcuts:
            return None
        solid = self._object
        if self.scene.neighbours:  # a finger that they stop may touch what it would have missed
            solid = ObjectSolid(self.scene, with_neighbours=True)
        return ContactFilter(
            self.scene.gripper,
            solid,
            lambda posture, synergy: self._worlds[0].closing(posture, synergy),
            follows_free_joints=self._protocol.free_joints_first,
            sight=self._worlds[0].sight,
        )

    def _make_worlds(self) -> list[ShakenWorld | PhysicalWorld]:
        with ExitStack() as undo:
            worlds = []
            for name in engine_names(self.scene.engine):
                worlds.append(make_world(self.scene, self._protocol, name))
                undo.callback(worlds[-1].close)
            undo.pop_all()
        return worlds

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the worlds; closing twice is allowed."""
        for world in self._worlds:
            world.close()

    def _judge(self, prior: str, rows: Rows, grasps: DecodedGrasps, places: list[int]) -> dict[int, str]:
        found = self._simulate({i: (grasps[i], int(rows["trial"][i])) for i in places})
        fill_rows(rows, grasps, {i: each for i, each in found.items() if not isinstance(each, str)})
        return {i: each for i, each in found.items() if isinstance(each, str)}

    def _simulate(self, poses: dict[int, tuple[HandPose, int]]) -> dict[int, EpisodeResult | str]:
        """Return the results of poses in their trials, or the reasons of failures."""
        return {row: self._simulate_one(*pose) for row, pose in poses.items()}

    def _simulate_one(self, pose: HandPose, trial: int) -> EpisodeResult | str:
        """Return the result of a pose, or the reason of a failure, after which the worlds are new."""
        try:
            setup = self._protocol.trial(pose, trial)
            return verdict_in_all(self._episode.run(setup), self._worlds[1:], self._protocol, setup)
        except Exception as error:  # noqa: BLE001  # any failure is this row's result and no other's
            self.close()
            self._worlds = self._make_worlds()
            return f"{type(error).__name__}: {error}"

    @property
    def _episode(self) -> ShakenEpisode | PhysicalEpisode:
        """Episodes in the first engine."""
        return make_episode(self._worlds[0], self._protocol, self._contact_filter)


def verdict_in_all(
    verdict: EpisodeResult,
    others: Sequence[ShakenWorld | PhysicalWorld],
    protocol: EvaluationProtocol,
    trial: TrialSetup,
) -> EpisodeResult:
    """The result of a trial in all engines, given that of the first one.

    A grasp that holds is tried in the next world; outcome and fitness are those of its last world, where an
    overlap or a miss counts as no disturbance survived. The steps are those of all engines, all other values
    those of the first one.
    """
    for world in others:
        if verdict.outcome is Outcome.HELD:
            found = make_episode(world, protocol).run(trial)
            outcome, steps = outcome_of(found.fitness, protocol.disturbances), verdict.steps + found.steps
            verdict = verdict._replace(outcome=outcome, fitness=found.fitness, steps=steps)
    return verdict


def make_episode(
    world: ShakenWorld | PhysicalWorld,
    protocol: EvaluationProtocol,
    contact_filter: ContactFilter | None = None,
) -> ShakenEpisode | PhysicalEpisode:
    """The episodes of a protocol in a world that `make_world` made."""
    if isinstance(world, PhysicalWorld):
        if protocol.lift:
            return LiftEpisode(world, protocol, contact_filter, protocol.lift)
        return PhysicalEpisode(world, protocol, contact_filter)
    return ShakenEpisode(world, protocol, contact_filter)


def row_refusals(
    genomes: NDArray[np.float32], trials: NDArray[np.uint16], grasps: DecodedGrasps, last: int
) -> dict[int, str]:
    """The reasons why rows cannot be evaluated, by place; `last` is the last trial."""
    beyond = f"this evaluation protocol has no trial {f'above {last}' if last else 'but 0'}"
    senseless = "the genome stands for no pose: it holds, or leads to, numbers that are not finite"
    is_finite = np.isfinite(genomes).all(axis=1) & grasps.are_finite
    (places,) = np.nonzero(~is_finite | (trials > last))
    return {i: beyond if is_finite[i] else senseless for i in places.tolist()}


def fill_rows(rows: Rows, grasps: DecodedGrasps, verdicts: dict[int, EpisodeResult]) -> None:
    """Write the result columns of the rows that have a result, by their place in the batch."""
    if not verdicts:
        return
    places, found = list(verdicts), list(verdicts.values())
    positions = grasps.positions[places]
    columns = {
        "outcome": [verdict.outcome for verdict in found],
        "fitness": [verdict.fitness for verdict in found],
        "steps": [verdict.steps for verdict in found],
        "descriptor": positions,
        "base_to_object": np.concatenate([positions, grasps.quaternions[places]], axis=1),
        "joints": [verdict.joints for verdict in found],
        "surface_point": grasps.surface_points[places],
        "nu": grasps.nu[places],
        "contacts": [verdict.finger_links for verdict in found],
        "penetration": [verdict.penetration for verdict in found],
    }
    for name, values in columns.items():
        rows[name][places] = values
    if slots := rows.dtype["contact_links"].shape[0]:
        rows["settled"][places] = [verdict.settled for verdict in found]
        for place, verdict in zip(places, found, strict=True):
            links, values = contact_columns(verdict.contacts, slots)
            rows["contact_links"][place, : len(links)] = links
            rows["contact_points"][place, : len(values)] = values


MAX_HALF = float(np.finfo(np.float16).max)


def contact_columns(contacts: Sequence[GraspContact], slots: int) -> tuple[list[int], list[float]]:
    """Links of the contacts that a row has room for, and their points, normals and forces."""
    kept = spread_contacts(contacts, slots) if slots else []
    values = np.array([[*contact.point, *contact.normal, contact.force] for contact in kept])
    numbers: list[float] = values.clip(-MAX_HALF, MAX_HALF).ravel().tolist()
    return [contact.link for contact in kept], numbers


def spread_contacts(contacts: Sequence[GraspContact], most: int) -> list[GraspContact]:
    """At most `most` of the contacts, far from each other, that bear the forces of all.

    The first is the one with the greatest force, each next one the one farthest from all before it. The force
    of one that is left out goes to the nearest contact of its own link, or of any where its link has none.
    """
    if len(contacts) <= most:
        return list(contacts)
    points = np.array([contact.point for contact in contacts])
    offsets = points[:, None] - points[None]
    apart = dot(offsets, offsets)
    kept = [int(np.argmax([contact.force for contact in contacts]))]
    while len(kept) < most:
        kept.append(int(apart[:, kept].min(axis=1).argmax()))
    forces = {place: contacts[place].force for place in kept}
    for place, contact in enumerate(contacts):
        if place not in kept:
            own = [each for each in kept if contacts[each].link == contact.link] or kept
            forces[min(own, key=lambda each: float(apart[place, each]))] += contact.force
    return [contacts[place]._replace(force=forces[place]) for place in kept]


def make_evaluator(scene: Scene, device: Device | None = None) -> BatchEvaluator:
    """The evaluator of a scene; an InputError where its engine needs a device that is not here."""
    if scene.engine != DEVICE_ENGINE:
        return Evaluator(scene)
    if device is None:
        raise InputError(
            f"This worker has no device for the engine {DEVICE_ENGINE}: start it as qdgrasp-worker "
            "--device cuda, with qdgrasp[gpu] installed."
        )
    made: BatchEvaluator = import_module(DEVICE_MODULE).WarpEvaluator(scene, device)
    return made


MAX_EVALUATORS = 8  # A Bullet world takes 39 to 47 MB


class EvaluatorCache:
    """Evaluators by their scene's digest, of a bounded weight; the longest unused leaves first."""

    def __init__(self) -> None:
        self._evaluators: OrderedDict[str, BatchEvaluator] = OrderedDict()

    def __len__(self) -> int:
        return len(self._evaluators)

    def __contains__(self, digest: str) -> bool:
        return digest in self._evaluators

    def get(self, digest: str, load: Callable[[], BatchEvaluator]) -> BatchEvaluator:
        """Return the evaluator of a scene, made by `load` if it is not here yet."""
        if digest not in self._evaluators:
            self._drop_oldest(MAX_EVALUATORS - 1)
            made = load()
            self._drop_oldest(MAX_EVALUATORS - made.weight)
            self._evaluators[digest] = made
        self._evaluators.move_to_end(digest)
        return self._evaluators[digest]

    def _drop_oldest(self, weight: int) -> None:
        """Close evaluators until they are of a weight at most."""
        before = len(self)
        while sum(each.weight for each in self._evaluators.values()) > weight:
            self._evaluators.popitem(last=False)[1].close()
        if len(self) < before:
            gc.collect()  # worlds refer to one another: dozens would stay until Python collects them

    def close(self) -> None:
        """Close all evaluators; closing twice is allowed."""
        while self._evaluators:
            self._evaluators.popitem()[1].close()
        gc.collect()
