"""Replays one evaluation: carries it out again as it was, and records its course.

Started as `python -m qdgrasp_worker.replay FOLDER` (`qdgrasp_protocol.replay_messages`). No shortcut
is taken: the hand closes to the end where an evaluation would already know that it misses.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import numpy as np
import typer
from msgspec import structs

from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.geometry.rotation import conjugate, multiply, rotate
from qdgrasp_assets.scene import Scene, SceneGripper, unpack_scene
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.messages import deflated
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.replay_messages import (
    ANSWER,
    REPLAYED,
    REQUEST,
    SCENE,
    ContactPoint,
    Phase,
    ReplayAnswer,
    ReplayRequest,
    Snapshot,
)
from qdgrasp_protocol.rows import GIVEN, Outcome, RowShape, pack
from qdgrasp_protocol.spec import engine_names
from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.episode import EpisodeResult
from qdgrasp_worker.evaluation_protocols import Shake, TrialSetup, scene_protocol
from qdgrasp_worker.evaluator import fill_rows, make_episode, verdict_in_all
from qdgrasp_worker.pose_filters import ApproachFilter
from qdgrasp_worker.world import GraspWorld

STEPS_PER_SECOND = 240  # Time is counted in steps of 1/240 s, in any engine
PHASE_BY_SHAKE: dict[str, Phase] = {"z": "shake z", "x": "shake x"}


class EpisodeRecorder:
    """Records the last evaluation in a world.

    It wraps the world's actions in an episode, and takes a snapshot after each. Snapshots are in the frame of
    the object's centre of mass as the object lies at first.
    """

    def __init__(self, world: GraspWorld, gripper: SceneGripper) -> None:
        self.snapshots: list[Snapshot] = []
        self._world, self._finger_links = world, frozenset(gripper.finger_links)
        self._phase: Phase = "placed"
        self._step = self._taken = 0
        looks: dict[str, Callable[..., None]] = {
            "reset": self._placed,
            "set_fingers": self._fingers_set,
            "close_fingers": lambda _synergy: self._begin("closing"),
            "step": self._stepped,
            "shake_to": self._shaken,
            "release": lambda: self._begin("settling"),
            "disturb": lambda: self._begin("lift" if getattr(world, "table", None) else "pushes"),
        }
        for verb, look in looks.items():
            if hasattr(world, verb):
                setattr(world, verb, followed(getattr(world, verb), look))

    def _placed(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Forget the last recording; the object is at its first pose."""
        position, quaternion = (np.array(part) for part in self._world.state().object)
        self._origin, self._back = position, conjugate(quaternion)
        self.snapshots.clear()
        self._begin("placed")

    def _fingers_set(self, posture: Sequence[float]) -> None:
        """Record the fingers; the contacts are still those of the look before."""
        placed = self.snapshots.pop()
        self.snapshots.append(structs.replace(self._now(), touches=placed.touches))

    def _shaken(self, target: float, shake: Shake) -> None:
        if self._phase != PHASE_BY_SHAKE[shake.joint]:
            self._begin(PHASE_BY_SHAKE[shake.joint])

    def _stepped(self) -> None:
        self._taken += 1
        steps = self._taken * self._world.step_seconds * STEPS_PER_SECOND
        if abs(steps - round(steps)) < 1e-6:  # every other one where steps are half as long
            self._step = round(steps)
            self.snapshots.append(self._now())

    def _begin(self, phase: Phase) -> None:
        """Begin a phase, in which nothing has moved yet: an engine may have forgotten its contacts."""
        self._phase, self._step, self._taken = phase, 0, 0
        before, now = self.snapshots[-1:], self._now()
        self.snapshots.append(structs.replace(now, touches=before[0].touches) if before else now)

    def _now(self) -> Snapshot:
        (root, turned), joints, (target, turned_target), touches = self._world.state()
        places = np.array([root, target, *(touch.point for touch in touches)]) - self._origin
        normals = np.array([touch.normal for touch in touches]).reshape(-1, 3)
        root, target, *points = rotate(self._back, places).tolist()
        turned, turned_target = multiply(self._back, np.array([turned, turned_target])).tolist()
        return Snapshot(
            phase=self._phase,
            step=self._step,
            root=(*root, *turned),
            joints=dict(joints),
            object=(*target, *turned_target),
            touches=tuple(
                ContactPoint(
                    link=touch.link,
                    is_finger=touch.link in self._finger_links,
                    point=tuple(point),
                    normal=tuple(normal),
                    distance=touch.distance,
                )
                for touch, point, normal in zip(
                    touches, points, rotate(self._back, -normals).tolist(), strict=True
                )
            ),
        )


def followed(act: Callable[..., None], look: Callable[..., None]) -> Callable[..., None]:
    """Return a function that calls `act` and then `look` with the same arguments."""

    def act_and_look(*arguments: object) -> None:
        act(*arguments)
        look(*arguments)

    return act_and_look


def replay_evaluation(scene: Scene, request: ReplayRequest) -> ReplayAnswer:
    """Carry an evaluation out again, the course in the scene's first engine, the verdict in all."""
    protocol = scene_protocol(scene)
    with closing(make_world(scene, protocol)) as world:
        recorder = EpisodeRecorder(world, scene.gripper)
        episode = make_episode(world, protocol)
        genome = np.array([request.genome], dtype=np.float32)
        grasps = Decoder(scene, GIVEN, ObjectSurface(scene))(genome)
        trial = protocol.trial(grasps[0], request.trial)
        if request.trial == 0 and len(ApproachFilter(scene)(grasps, np.arange(1))):
            episode.overlaps(trial)
            verdict = EpisodeResult(Outcome.OVERLAP, trial.pose.joints)
        else:
            verdict = episode.run(trial)
    with ExitStack() as opened:
        names = engine_names(scene.engine)[1:]
        others = [opened.enter_context(closing(make_world(scene, protocol, name))) for name in names]
        found = verdict_in_all(verdict, others, protocol, trial)
    row = RowShape(len(request.genome), len(scene.gripper.joints), scene.contact_slots).empty(1)
    fill_rows(row, grasps, {0: found})
    return ReplayAnswer(columns=deflated(pack(row, REPLAYED)), snapshots=tuple(recorder.snapshots))


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def replay_folder(folder: Path) -> None:
    """Replay the evaluation of a folder's request, and write the answer beside it."""
    with lifetime("qdgrasp-replay") as stop:
        stop.tell(lambda: os._exit(stop.exit_code))  # only a temporary folder is left behind
        request = msgspec.json.decode((folder / REQUEST).read_bytes(), type=ReplayRequest)
        answer = replay_evaluation(unpack_scene((folder / SCENE).read_bytes()), request)
        (folder / ANSWER).write_bytes(msgspec.json.encode(answer))


if __name__ == "__main__":
    run_command(app, "qdgrasp-replay")
