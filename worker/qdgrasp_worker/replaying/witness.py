"""The witness: a world that remembers what happens in it, and has no say in it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.replay import Phase
from qdgrasp_worker.bullet import BASE
from qdgrasp_worker.grasp import Pose
from qdgrasp_worker.protocols import Shake
from qdgrasp_worker.replaying import eye
from qdgrasp_worker.replaying.moment import Moment
from qdgrasp_worker.world import World

SHAKES: dict[str, Phase] = {"z": "shake z", "x": "shake x"}


class Witness(World):
    """A world that is asked for the moments of its last evaluation; a context manager that leaves it."""

    _is_watching = False  # while the world is made its hand closes on nothing
    _phase: Phase = "placed"
    _step = 0

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        links = self._bullet.links(self._hand.body)
        self.joints = [links[joint].joint for joint in self._joints]
        """The names of all joints that move."""
        self._links = {BASE: "root"} | {number: link.link for number, link in enumerate(links)}
        self.moments: list[Moment] = []
        self._is_watching = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def reset(
        self, pose: Pose, posture: Sequence[float], frictions: tuple[float, float] | None = None
    ) -> None:
        """Put hand and object in place, and forget what was remembered."""
        super().reset(pose, posture, frictions)
        self._root = pose.position, pose.quaternion
        if self._is_watching:
            self.moments.clear()
            self._begin("placed")

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture`; the contacts are still those of the look before."""
        super().set_fingers(posture)
        placed = self.moments.pop()
        self.moments.append(replace(self._now(), touches=placed.touches))

    def close_fingers(self, synergy: int) -> None:
        """Command the fingers to close."""
        super().close_fingers(synergy)
        if self._is_watching:
            self._begin("closing")

    def shake_to(self, target: float, shake: Shake) -> None:
        """Command the carrier to a target of a shake."""
        super().shake_to(target, shake)
        if self._phase != SHAKES[shake.joint]:
            self._begin(SHAKES[shake.joint])

    def step(self) -> None:
        """Move on by 1/240 s."""
        super().step()
        if self._is_watching:
            self._step += 1
            self.moments.append(self._now())

    def _begin(self, phase: Phase) -> None:
        self._phase, self._step = phase, 0
        self.moments.append(self._now())

    def _now(self) -> Moment:
        """What there is."""
        hand, target = self._hand.body, self._target.body
        return Moment(
            self._phase,
            self._step,
            self._root,
            self._bullet.joints(hand, self._joints),
            eye.pose(self._bullet, target),
            eye.touches(self._bullet, hand, target, self._links, self.finger_links),
        )
