"""A replay: carry one evaluation out again as it was, remember it, and draw it.

The episode is the one that evaluates, in a world that is asked what happened. No shortcut is taken: the hand
closes to the end where an evaluation would know by then that it misses.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_assets.urdf import tree
from qdgrasp_protocol import replay
from qdgrasp_protocol.genome import GIVEN
from qdgrasp_protocol.replay import Answer, Camera, Request, Shot
from qdgrasp_worker.decode import Decoder
from qdgrasp_worker.episode import Episode, Verdict
from qdgrasp_worker.protocols import PROTOCOLS
from qdgrasp_worker.replaying.aim import aimed, best_view
from qdgrasp_worker.replaying.eye import Eye
from qdgrasp_worker.replaying.film import REST, Take, film, still
from qdgrasp_worker.replaying.moment import Moment
from qdgrasp_worker.replaying.witness import Witness
from qdgrasp_worker.surface import Surface
from qdgrasp_worker.trial import Trial

FINE = 2
"""So many pixels are drawn for each that is shown, along each axis."""
Frames = NDArray[np.uint8]
"""(n, rows, columns, 3)."""
Film = Callable[[int, int, int], Frames]
"""Makes room for so many frames of so many rows and columns."""


class Replay:
    """One evaluation, carried out again.

    Raises
    ------
    AssetError
        Bullet cannot load the scene.
    """

    def __init__(self, scene: Scene, request: Request) -> None:
        self._scene = scene
        self._request = request
        with Witness(scene) as world:
            episode = Episode(world, PROTOCOLS[scene.protocol], stops_early=False)
            self.verdict: Verdict = episode.run(trial(scene, request))
            self.moments = world.moments
            self._joints = world.joints
        self._robot = tree(Path(), ET.fromstring(scene.gripper.urdf))  # noqa: S314  # the scene's own

    def takes(self) -> list[Take]:
        """What is shown of it.

        Raises
        ------
        InputError
            The part that is asked for did not happen.
        """
        if self._request.what is None:
            return [Take(still(self.moments), REST)]
        return film(self.moments, self._request.what, self.verdict.outcome)

    def draw(self, make: Film) -> Answer:
        """Draw what is asked for into frames that `make` makes room for.

        Raises
        ------
        InputError
            The part that is asked for did not happen.
        """
        request, takes = self._request, self.takes()
        width, height = request.width, request.height
        with Eye(self._scene, parts=request.parts) as eye:
            grasp = still(self.moments)
            view = request.view or best_view(eye, grasp)
            lens = aimed(eye, [take.moment for take in takes], grasp, view, width / height)
            frames = make(len(takes), height, width)
            for frame, take in zip(frames, takes, strict=True):
                eye.show(take.moment)
                frame[...] = coarse(eye.look(lens, FINE * width, FINE * height))
        return self._answer(takes, lens.camera(width, height))

    def hand(self, moment: Moment) -> replay.Pose:
        """The pose of the hand's base link."""
        root = np.eye(4)
        root[:3, :3] = Rotation.from_quat(moment.root[1]).as_matrix()
        root[:3, 3] = moment.root[0]
        positions = dict(zip(self._joints, moment.joints, strict=True))
        return pose(self._robot.forward(positions, root)[self._scene.gripper.base_link])

    def _answer(self, takes: list[Take], camera: Camera) -> Answer:
        found = self.verdict
        return Answer(
            outcome=found.outcome,
            fitness=found.fitness,
            joints=tuple(found.joints),
            contacts=found.contacts,
            penetration=found.penetration,
            camera=camera,
            shots=tuple(self._shot(take) for take in takes),
        )

    def _shot(self, take: Take) -> Shot:
        moment = take.moment
        return Shot(
            phase=moment.phase,
            step=moment.step,
            seconds=take.seconds,
            hand=self.hand(moment),
            object=told(*moment.object),
            touches=moment.touches,
        )


def trial(scene: Scene, request: Request) -> Trial:
    """What is simulated."""
    genome = np.array([request.genome], dtype=np.float32)
    grasp = Decoder(scene, GIVEN, Surface(scene))(genome)[0]
    return PROTOCOLS[scene.protocol].trial(grasp, request.trial)


def coarse(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The means of squares of `FINE` by `FINE` pixels."""
    parts = [image[row::FINE, column::FINE] for row in range(FINE) for column in range(FINE)]
    total = np.asarray(np.sum(parts, axis=0, dtype=np.uint16))
    means = (total + FINE * FINE // 2) // (FINE * FINE)
    return means.astype(np.uint8)


def pose(frame: Floats) -> replay.Pose:
    """A frame (4, 4) as a position and a quaternion."""
    return told(frame[:3, 3].tolist(), Rotation.from_matrix(frame[:3, :3]).as_quat().tolist())


def told(position: list[float], quaternion: list[float]) -> replay.Pose:
    """A position [m] and a quaternion xyzw as one."""
    (x, y, z), (qx, qy, qz, qw) = position, quaternion
    return x, y, z, qx, qy, qz, qw
