"""MuJoCo beside Bullet, pose by pose: `python -m benchmarks.physics.engines`.

Poses are those that touch the object in Bullet, of the priors `contact` and, for two-finger hands, also
`antipodal`: the first ones that Bullet holds and the first ones that it does not, `--held` and `--lost` of
them. Both engines evaluate each in turns, and each engine again at half the time step, so that a reader sees
how much of a disagreement is between the engines.

CPU times are of all poses of a scene, engines in turns within each pose; `--rounds` repeats that, and tells
the median. The ratio on equal steps is that of the times of a step.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import msgspec
import numpy as np
from benchmarks.physics.__main__ import poses_of
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.engines.bullet_world import BulletPhysicalWorld, BulletShakenWorld
from qdgrasp_worker.engines.mujoco_world import TIME_STEP, MujocoPhysicalWorld, MujocoShakenWorld
from qdgrasp_worker.episode import EpisodeResult
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, EvaluationProtocol, Shake, TrialSetup
from qdgrasp_worker.evaluator import make_episode
from qdgrasp_worker.physical_episode import PhysicalWorld, angle_between
from qdgrasp_worker.world import ShakenWorld

SCENES = (
    ("panda", "ycb_rubiks_cube"),
    ("panda", "ycb_mug"),
    ("panda", "ycb_power_drill"),
    ("panda", "ycb_bleach_cleanser"),
    ("panda", "ycb_spatula"),
    ("robotiq_2f", "ycb_mug"),
    ("allegro", "ycb_mug"),
    ("barrett", "ycb_mug"),
    ("shadow", "ycb_mug"),
)
"""The cleanser is a bottle with a spray-like neck, the spatula a thin object."""
ITERATIONS = 50  # Bullet's own
AnyWorld = ShakenWorld | PhysicalWorld


class HalfStepBullet(BulletShakenWorld):
    """Bullet with two half steps for each step, and motors of the same velocities."""

    def _prepare(self, gripper: SceneGripper) -> None:
        self._bullet.set_stepping(TIME_STEP / 2, ITERATIONS)
        super()._prepare(gripper)
        self._closing = {
            label: [
                (index, target, replace(motor, position_gain=motor.position_gain / 2))
                for index, target, motor in commands
            ]
            for label, commands in self._closing.items()
        }

    def shake_to(self, target: float, shake: Shake) -> None:
        super().shake_to(target, replace(shake, position_gain=shake.position_gain / 2))

    def step(self) -> None:
        super().step()
        super().step()


class HalfStepMujoco(MujocoShakenWorld):
    """MuJoCo with two half steps for each step."""

    _time_step = TIME_STEP / 2

    def step(self) -> None:
        super().step()
        super().step()


def half_step_world(scene: Scene, protocol: EvaluationProtocol) -> AnyWorld:
    """A world of the scene's engine at half the time step."""
    if not protocol.physics:
        return HalfStepMujoco(scene) if scene.engine else HalfStepBullet(scene)
    physics = replace(
        protocol.physics,
        time_step=protocol.physics.time_step / 2,
        look_every=2 * protocol.physics.look_every,
    )
    return MujocoPhysicalWorld(scene, physics) if scene.engine else BulletPhysicalWorld(scene, physics)


class Verdict(NamedTuple):
    """The result of a pose in an engine."""

    result: EpisodeResult
    seconds: float
    steps: int


class PoseEvaluator:
    """Evaluates poses in a world, and counts its steps."""

    def __init__(self, world: AnyWorld, protocol: EvaluationProtocol) -> None:
        self._episode = make_episode(world, protocol)
        self._steps, step, at_once = 0, world.step, getattr(world, "steps_at_once", 1)

        def counted() -> None:
            self._steps += at_once
            step()

        world.step = counted  # type: ignore[method-assign]

    def __call__(self, pose: HandPose) -> Verdict:
        self._steps, started = 0, time.process_time()
        result = self._episode.run(TrialSetup(pose))
        return Verdict(result, time.process_time() - started, self._steps)


def chosen_poses(
    scene: Scene, evaluate: Callable[[HandPose], Verdict], held: int, lost: int
) -> list[HandPose]:
    """The first poses that touch: some that hold and some that do not."""
    found: dict[bool, list[HandPose]] = {True: [], False: []}
    for pose in poses_of(scene, seed=1):
        outcome = evaluate(pose).result.outcome
        holds = outcome is Outcome.HELD
        if outcome.is_touched and len(found[holds]) < (held if holds else lost):
            found[holds].append(pose)
            if len(found[True]) == held and len(found[False]) == lost:
                break
    return found[True] + found[False]


def kappa(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Cohen's kappa of two lists of verdicts."""
    chance = one.mean() * other.mean() + (1 - one.mean()) * (1 - other.mean())
    return float(((one == other).mean() - chance) / (1 - chance)) if chance < 1 else 1.0


def figures(hand: str, target: str, protocol: str, held: int, lost: int, rounds: int) -> dict[str, Any]:
    """The figures of a hand, an object and a protocol."""
    spec = RunSpec(gripper=hand, object=target, protocol=protocol)  # type: ignore[arg-type]
    first = build_scene(spec)
    second = build_scene(msgspec.structs.replace(spec, engine="mujoco"))
    rules = PROTOCOLS[protocol]
    makers = {
        "bullet": lambda: make_world(first, rules),
        "mujoco": lambda: make_world(second, rules),
        "bullet half": lambda: half_step_world(first, rules),
        "mujoco half": lambda: half_step_world(second, rules),
    }
    with ExitStack() as worlds:
        evaluators = {
            name: PoseEvaluator(worlds.enter_context(closing(make())), rules) for name, make in makers.items()
        }
        poses = chosen_poses(first, evaluators["bullet"], held, lost)
        found = {
            name: [evaluate(pose) for pose in poses]
            for name, evaluate in evaluators.items()
            if "half" in name
        }
        times: dict[str, list[float]] = {"bullet": [], "mujoco": []}
        for _ in range(rounds):
            pairs = [(evaluators["bullet"](pose), evaluators["mujoco"](pose)) for pose in poses]
            for name, verdicts in zip(("bullet", "mujoco"), zip(*pairs, strict=True), strict=True):
                found[name] = list(verdicts)
                times[name].append(sum(verdict.seconds for verdict in verdicts))
    return {
        "hand": hand,
        "object": target.removeprefix("ycb_"),
        "protocol": protocol,
        **agreement(found),
        **speeds(found, times),
    }


def agreement(found: dict[str, list[Verdict]]) -> dict[str, Any]:
    """Agreement of the engines on which grasps are held."""
    holds = {
        name: np.array([each.result.outcome is Outcome.HELD for each in verdicts])
        for name, verdicts in found.items()
    }
    one, other = holds["bullet"], holds["mujoco"]
    both = [
        (a.result.settled, b.result.settled)
        for a, b in zip(found["bullet"], found["mujoco"], strict=True)
        if a.result.outcome.is_success and b.result.outcome.is_success
    ]
    away = [1e3 * float(np.linalg.norm(np.subtract(a[:3], b[:3]))) for a, b in both]
    turned = [float(np.degrees(angle_between(a[3:], b[3:]))) for a, b in both]
    return {
        "poses": len(one),
        "held bullet": float(one.mean()),
        "held mujoco": float(other.mean()),
        "same": float((one == other).mean()),
        "kappa": kappa(one, other),
        "same of held": float(other[one].mean()) if one.any() else None,
        "same of lost": float((~other[~one]).mean()) if not one.all() else None,
        "bullet half same": float((one == holds["bullet half"]).mean()),
        "mujoco half same": float((other == holds["mujoco half"]).mean()),
        "mm": median(away) if away else None,
        "deg": median(turned) if turned else None,
        "outcomes": {
            f"{a.name} {b.name}": n
            for (a, b), n in counted(
                (x.result.outcome, y.result.outcome)
                for x, y in zip(found["bullet"], found["mujoco"], strict=True)
            )
        },
    }


def counted(pairs: Any) -> list[tuple[tuple[Outcome, Outcome], int]]:
    """The number of each pair, sorted by pair."""
    listed = list(pairs)
    return [(pair, listed.count(pair)) for pair in sorted(set(listed))]


def speeds(found: dict[str, list[Verdict]], times: dict[str, list[float]]) -> dict[str, Any]:
    """CPU times and their ratios, medians over the rounds."""
    poses = len(found["bullet"])
    steps = {name: sum(each.steps for each in found[name]) for name in times}
    ratios = [one / other for one, other in zip(times["bullet"], times["mujoco"], strict=True)]
    return {
        "ms bullet": 1e3 * median(times["bullet"]) / poses,
        "ms mujoco": 1e3 * median(times["mujoco"]) / poses,
        "ratio": median(ratios),
        "steps bullet": steps["bullet"] / poses,
        "steps mujoco": steps["mujoco"] / poses,
        "ratio of a step": median(ratios) * steps["mujoco"] / steps["bullet"],
    }


def main(words: Sequence[str] | None = None) -> None:
    """Print a line of JSON for each scene and protocol."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", nargs="+", metavar="HAND:OBJECT", help="instead of all nine")
    parser.add_argument("--protocols", nargs="+", default=["paper", "physical"])
    parser.add_argument("--held", type=int, default=350)
    parser.add_argument("--lost", type=int, default=150)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--out", type=Path, help="also append the lines to this file")
    asked = parser.parse_args(words)
    scenes = [tuple(each.split(":")) for each in asked.scenes] if asked.scenes else SCENES
    for hand, target in scenes:
        for protocol in asked.protocols:
            row = figures(hand, target, protocol, asked.held, asked.lost, asked.rounds)
            line = json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()})
            print(line, flush=True)
            if asked.out:
                with asked.out.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")


if __name__ == "__main__":
    main()
