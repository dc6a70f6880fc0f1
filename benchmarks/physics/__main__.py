"""The protocol `physical` against `paper`, and against itself refined: `python -m benchmarks.physics`.

Poses are those that touch the object in `paper`, of the priors `contact` and, for two-finger hands, also
`antipodal`. Each is judged by both protocols, and by `physical` at half the time step and with twice the
iterations. CPU times are of all poses of one hand and object, the protocols in turns.

Constants were chosen on: Panda with rubiks_cube, mug and power_drill; Robotiq, Allegro, Shadow and Barrett
with rubiks_cube; Allegro with mug. All else is held out.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import Decoder, HandPose
from qdgrasp_worker.engines.bullet_world import BulletPhysicalWorld, BulletShakenWorld
from qdgrasp_worker.episode import EpisodeResult, ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PAPER, PHYSICAL, Physics, TrialSetup
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.physical_episode import PhysicalEpisode, angle_between
from qdgrasp_worker.world import GraspWorld

HANDS = ("panda", "robotiq_2f", "allegro", "barrett", "shadow", "ref_bh280", "ref_allegro")
OBJECTS = ("ycb_rubiks_cube", "ycb_mug", "ycb_bowl")
BATCH = 64
MOST_BATCHES = 200


def scene_of(hand: str, target: str, protocol: str) -> Scene:
    """The scene of a hand and an object under a protocol."""
    return build_scene(RunSpec(gripper=hand, object=target, protocol=protocol))  # type: ignore[arg-type]


@dataclass
class PoseResult:
    """The result of a pose under a protocol."""

    result: EpisodeResult
    seconds: float
    steps: int
    place: tuple[Any, Any] | None = None
    """Position and quaternion of the object after closing."""


class CountingWorld(BulletPhysicalWorld):
    """A world that counts its steps."""

    count = 0

    def step(self) -> None:
        """Make a step."""
        super().step()
        self.count += 1


@dataclass(frozen=True)
class RecordingEpisode(PhysicalEpisode):
    """An episode that stores the object's pose after closing."""

    places: list[tuple[Any, Any]] = field(default_factory=list)

    def _closed_grasp(self, pose: HandPose, fingers: int) -> EpisodeResult:
        self.places.append(self.world.object_pose())
        return super()._closed_grasp(pose, fingers)


def evaluate_pose(world: GraspWorld, episode: ShakenEpisode | RecordingEpisode, pose: HandPose) -> PoseResult:
    """Evaluate a pose."""
    places = episode.places if isinstance(episode, RecordingEpisode) else []
    places.clear()
    before, started = getattr(world, "count", 0), time.process_time()
    result = episode.run(TrialSetup(pose))
    seconds = time.process_time() - started
    return PoseResult(result, seconds, getattr(world, "count", 0) - before, places[0] if places else None)


def poses_of(scene: Scene, seed: int) -> Iterator[HandPose]:
    """Decoded poses, the priors in turns."""
    random, surface = np.random.default_rng(seed), ObjectSurface(scene)
    priors = ("contact", "antipodal") if scene.gripper.jaw else ("contact",)
    decoders = [(Decoder(scene, prior, surface), len(layout(scene, prior))) for prior in priors]
    for i in range(MOST_BATCHES):
        decoder, genes = decoders[i % len(decoders)]
        grasps = decoder(random.uniform(-1.0, 1.0, (BATCH, genes)).astype(np.float32))
        for place in range(len(grasps)):
            if grasps.are_finite[place] and not grasps.dead_ends[place]:
                yield grasps[place]


def touched_poses(scene: Scene, n: int, seed: int) -> list[HandPose]:
    """The first poses that touch in `paper`."""
    found: list[HandPose] = []
    with closing(BulletShakenWorld(scene)) as world:
        episode = ShakenEpisode(world, PAPER)
        for pose in poses_of(scene, seed):
            if episode.run(TrialSetup(pose)).outcome.is_touched:
                found.append(pose)
                if len(found) == n:
                    break
    return found


def physical_runs(scene: Scene, physics: Physics, poses: Sequence[HandPose]) -> list[PoseResult]:
    """The results of poses under `physical` with other settings."""
    with closing(CountingWorld(scene, physics)) as world:
        episode = RecordingEpisode(world, replace(PHYSICAL, physics=physics))
        return [evaluate_pose(world, episode, pose) for pose in poses]


def side_by_side(
    paper_scene: Scene, scene: Scene, physics: Physics, poses: Sequence[HandPose]
) -> tuple[list[PoseResult], list[PoseResult]]:
    """The results of poses under both protocols, in turns."""
    with closing(BulletShakenWorld(paper_scene)) as first, closing(CountingWorld(scene, physics)) as second:
        paper = ShakenEpisode(first, PAPER)
        physical = RecordingEpisode(second, replace(PHYSICAL, physics=physics))
        pairs = [(evaluate_pose(first, paper, pose), evaluate_pose(second, physical, pose)) for pose in poses]
    return [one for one, _ in pairs], [other for _, other in pairs]


def held(found: Sequence[PoseResult]) -> np.ndarray:
    """Which poses are held, (n,)."""
    return np.array([each.result.outcome is Outcome.HELD for each in found])


def spread_of(one: Sequence[PoseResult], other: Sequence[PoseResult]) -> tuple[np.ndarray, np.ndarray]:
    """Distances [mm] and angles [deg] of the objects after closing, where both have touched."""
    pairs = [(a.place, b.place) for a, b in zip(one, other, strict=True) if a.place and b.place]
    away = np.array([dist(a[0], b[0]) * 1e3 for a, b in pairs] or [np.nan])
    turned = np.degrees([angle_between(a[1], b[1]) for a, b in pairs] or [np.nan])
    return away, turned


def figures(
    hand: str, target: str, n: int, seed: int, refine: bool, changes: dict[str, Any]
) -> dict[str, Any]:
    """The figures of a hand and an object."""
    paper_scene, scene = scene_of(hand, target, "paper"), scene_of(hand, target, "physical")
    poses = touched_poses(paper_scene, n, seed)
    physics = replace(Physics(), **changes)
    paper, physical = side_by_side(paper_scene, scene, physics, poses)
    success = [each.result for each in physical if each.result.outcome.is_success]
    depth = np.array([each.penetration * 1e3 for each in success] or [np.nan])
    moved = np.array([dist(each.place[0], (0, 0, 0)) * 1e3 for each in physical if each.place] or [np.nan])
    row: dict[str, Any] = {
        "hand": hand,
        "object": target.removeprefix("ycb_"),
        "poses": len(poses),
        "success paper": np.mean([each.result.outcome.is_success for each in paper]),
        "held paper": held(paper).mean(),
        "overlap": np.mean([each.result.outcome is Outcome.OVERLAP for each in physical]),
        "success": len(success) / max(1, len(poses)),
        "held": held(physical).mean(),
        "fitness": np.mean([each.result.fitness for each in physical]),
        "depth med": np.median(depth),
        "depth p99": np.percentile(depth, 99),
        "moved med": np.median(moved),
        "ms paper": np.mean([each.seconds for each in paper]) * 1e3,
        "ms": np.mean([each.seconds for each in physical]) * 1e3,
        "cpu": sum(each.seconds for each in physical) / sum(each.seconds for each in paper),
        "steps": np.mean([each.steps for each in physical]),
    }
    if refine:
        half = replace(physics, time_step=physics.time_step / 2, look_every=2 * physics.look_every)
        twice = replace(physics, iterations=2 * physics.iterations, jaw_iterations=2 * physics.jaw_iterations)
        for label, other in {"half step": half, "twice its": twice}.items():
            again = physical_runs(scene, other, poses)
            away, turned = spread_of(physical, again)
            row[f"same, {label}"] = np.mean(held(physical) == held(again))
            row[f"mm, {label}"] = np.median(away)
            row[f"deg, {label}"] = np.median(turned)
    return row


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hands", nargs="+", default=HANDS)
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--poses", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-refine", action="store_true", help="leave out the refined runs")
    parser.add_argument(
        "--set", nargs="*", default=[], metavar="NAME=VALUE", help="other settings of Physics"
    )
    parser.add_argument("--out", help="also write the rows to this JSON file")
    asked = parser.parse_args()
    changes = {name: json.loads(value) for name, value in (each.split("=") for each in asked.set)}
    rows = []
    for hand in asked.hands:
        for target in asked.objects:
            rows.append(figures(hand, target, asked.poses, asked.seed, not asked.no_refine, changes))
            print(
                json.dumps({k: round(v, 3) if isinstance(v, float) else v for k, v in rows[-1].items()}),
                file=sys.stderr,
                flush=True,
            )
    table = Table()
    for name in rows[0]:
        table.add_column(name)
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(width=220).print(table)
    if asked.out:
        Path(asked.out).write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
