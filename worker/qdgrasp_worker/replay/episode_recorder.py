"""Records the snapshots of an evaluation, and chooses which are shown, and for how long."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qdgrasp_assets.geometry.rotation import conjugate, multiply, rotate
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.replay_messages import ContactPoint, Phase, ReplayPart
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.evaluation_protocols import Shake, TrialSetup
from qdgrasp_worker.replay.renderer import Snapshot
from qdgrasp_worker.world import GraspWorld

STEPS_PER_SECOND = 240  # Time is counted in steps of 1/240 s, in any engine
STEPS_PER_FRAME = 6  # Least number of steps from one frame to the next
FRAME_SECONDS = 0.08  # Seconds for which a frame of so many steps is shown: 3.2 times slower than simulated
REST_SECONDS = 0.96  # seconds for which the hand rests before it closes, when it has closed, and at the end
PARTS: dict[ReplayPart, tuple[str, ...]] = {
    "all": ("placed", "closing", "settling", "shake z", "shake x", "pushes", "lift"),
    "closing": ("placed", "closing", "settling"),
    "shakes": ("shake z", "shake x", "pushes", "lift"),
}


class TimedSnapshot(NamedTuple):
    """A snapshot, and the time for which it is shown."""

    snapshot: Snapshot
    seconds: float


def still_snapshot(snapshots: Sequence[Snapshot]) -> Snapshot:
    """The hand after closing; where it did not close, as it was placed."""
    return [snapshot for snapshot in snapshots if snapshot.phase in PARTS["closing"]][-1]


def placed_snapshot(snapshots: Sequence[Snapshot]) -> Snapshot:
    """The hand as it was placed, before closing."""
    return [snapshot for snapshot in snapshots if snapshot.phase == "placed"][-1]


def animation(snapshots: Sequence[Snapshot], what: ReplayPart, outcome: Outcome) -> list[TimedSnapshot]:
    """The snapshots of one part of an evaluation, in time; an InputError if it did not happen.

    These are the first and the last of each phase, and between them one every `STEPS_PER_FRAME` steps, or the
    next one after that. Each is shown until the time of the next.
    """
    chosen = [snapshot for snapshot in snapshots if snapshot.phase in PARTS[what]]
    if not chosen:
        raise InputError(f"This evaluation has no {what} to show: its outcome is {outcome.name.lower()}.")
    frames = list[Snapshot]()
    for snapshot, following in zip(chosen, [*chosen[1:], None], strict=True):
        is_first = not frames or frames[-1].phase != snapshot.phase
        is_last = following is None or following.phase != snapshot.phase
        if is_first or is_last or snapshot.step - frames[-1].step >= STEPS_PER_FRAME:
            frames.append(snapshot)
    shown = []
    for frame, next_frame in zip(frames, [*frames[1:], None], strict=True):
        seconds = FRAME_SECONDS
        if next_frame and next_frame.phase == frame.phase:
            seconds *= (next_frame.step - frame.step) / STEPS_PER_FRAME
        elif next_frame is None or frame.phase in PARTS["closing"]:
            seconds = REST_SECONDS
        shown.append(TimedSnapshot(frame, seconds))
    return shown


PHASE_BY_SHAKE: dict[str, Phase] = {"z": "shake z", "x": "shake x"}


class EpisodeRecorder:
    """Records the last evaluation in a world of any engine.

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
            "close_fingers": self._closing,
            "step": self._stepped,
            "shake_to": self._shaken,
            "release": lambda: self._begin("settling"),
            "begin_pushes": lambda: self._begin("pushes"),
            "begin_lift": lambda: self._begin("lift"),
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
        self.snapshots.append(replace(self._now(), touches=placed.touches))

    def _closing(self, synergy: int) -> None:
        self._begin("closing")

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
        self.snapshots.append(replace(now, touches=before[0].touches) if before else now)

    def _now(self) -> Snapshot:
        (root, turned), joints, (target, turned_target), touches = self._world.state()
        places = np.array([root, target, *(touch.point for touch in touches)]) - self._origin
        normals = np.array([touch.normal for touch in touches]).reshape(-1, 3)
        root, target, *points = rotate(self._back, places).tolist()
        turned, turned_target = multiply(self._back, np.array([turned, turned_target])).tolist()
        return Snapshot(
            self._phase,
            self._step,
            (root, turned),
            joints,
            (target, turned_target),
            tuple(
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
