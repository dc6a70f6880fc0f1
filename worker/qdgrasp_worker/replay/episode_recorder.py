"""Records the snapshots of an evaluation, and chooses which are shown, and for how long."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.replay_messages import Phase, ReplayPart
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.engines.bullet import BASE
from qdgrasp_worker.engines.bullet_world import BulletPhysicalWorld, BulletShakenWorld, BulletWorld
from qdgrasp_worker.evaluation_protocols import EvaluationProtocol, Physics, Shake, TrialSetup
from qdgrasp_worker.replay import renderer
from qdgrasp_worker.replay.renderer import Snapshot

STEPS_PER_FRAME = 6  # Steps, at 240 Hz, from one frame to the next
FRAME_SECONDS = 0.08  # Seconds for which a frame is shown: 3.2 times slower than simulated
REST_SECONDS = 0.96  # seconds for which the hand rests before it closes, when it has closed, and at the end
PARTS: dict[ReplayPart, tuple[str, ...]] = {
    "all": ("placed", "closing", "settling", "shake z", "shake x", "pushes"),
    "closing": ("placed", "closing", "settling"),
    "shakes": ("shake z", "shake x", "pushes"),
}


class TimedSnapshot(NamedTuple):
    """A snapshot that is shown."""

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

    Every so many steps one, and the last of each phase.
    """
    chosen = [snapshot for snapshot in snapshots if snapshot.phase in PARTS[what]]
    if not chosen:
        raise InputError(f"This evaluation has no {what} to show: its outcome is {outcome.name.lower()}.")
    shown = []
    for snapshot, following in zip(chosen, [*chosen[1:], None], strict=True):
        is_last = following is None or following.phase != snapshot.phase
        rests = following is None or (is_last and snapshot.phase in PARTS["closing"])
        if is_last or snapshot.step % STEPS_PER_FRAME == 0:
            shown.append(TimedSnapshot(snapshot, REST_SECONDS if rests else FRAME_SECONDS))
    return shown


PHASE_BY_SHAKE: dict[str, Phase] = {"z": "shake z", "x": "shake x"}


class RecordingWorld(BulletWorld):
    """A world that records its last evaluation."""

    _is_watching = False  # while the world is made its hand closes on nothing
    _phase: Phase = "placed"
    _step = 0
    _parts, _parts_of_step = 0, 1

    def __init__(self, scene: Scene, *settings: Physics) -> None:
        super().__init__(scene, *settings)
        links = self._bullet.links(self._hand.body)
        self.joints = [links[joint].joint for joint in self._joints]
        """The names of all joints that move."""
        self._links = {BASE: "root"} | {number: link.link for number, link in enumerate(links)}
        self.snapshots: list[Snapshot] = []
        self._is_watching = True

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, and forget what was remembered."""
        super().reset(trial, posture)
        self._root = trial.pose.position, trial.pose.quaternion
        if self._is_watching:
            self.snapshots.clear()
            self._begin("placed")

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture`; the contacts are still those of the look before."""
        super().set_fingers(posture)
        placed = self.snapshots.pop()
        self.snapshots.append(replace(self._now(), touches=placed.touches))

    def close_fingers(self, synergy: int) -> None:
        """Command the fingers to close."""
        super().close_fingers(synergy)  # type: ignore[safe-super]
        if self._is_watching:
            self._begin("closing")

    def step(self) -> None:
        """Move on by a step."""
        super().step()
        if self._is_watching:
            self._parts += 1
            if self._parts % self._parts_of_step == 0:
                self._step += 1
                self.snapshots.append(self._now())

    def _begin(self, phase: Phase) -> None:
        self._phase, self._step, self._parts = phase, 0, 0
        self.snapshots.append(self._now())

    def _now(self) -> Snapshot:
        hand, target = self._hand.body, self._target.body
        return Snapshot(
            self._phase,
            self._step,
            self._root,
            self._bullet.joints(hand, self._joints),
            renderer.body_pose(self._bullet, target),
            renderer.contact_points(self._bullet, hand, target, self._links, self.finger_links),
        )


class RecordingShakenWorld(RecordingWorld, BulletShakenWorld):
    """A world whose hand is shaken, and which records its last evaluation."""

    def shake_to(self, target: float, shake: Shake) -> None:
        """Command the carrier to a target of a shake."""
        super().shake_to(target, shake)
        if self._phase != PHASE_BY_SHAKE[shake.joint]:
            self._begin(PHASE_BY_SHAKE[shake.joint])


class RecordingPhysicalWorld(RecordingWorld, BulletPhysicalWorld):
    """A world of `physical` that records its last evaluation."""

    _parts_of_step = 2  # its steps are half as long

    def release(self) -> None:
        """Let the object go."""
        super().release()
        self._begin("settling")

    def begin_pushes(self) -> None:
        """Let all targets stay."""
        super().begin_pushes()
        self._begin("pushes")


def recording_world(
    scene: Scene, protocol: EvaluationProtocol
) -> RecordingShakenWorld | RecordingPhysicalWorld:
    """A world that records episodes; an AssetError if Bullet cannot load the scene."""
    if scene.engine is not None:
        raise InputError(f"An evaluation in the engine {scene.engine} cannot be drawn; one in Bullet can.")
    return (
        RecordingPhysicalWorld(scene, protocol.physics) if protocol.physics else RecordingShakenWorld(scene)
    )
