"""Replays one evaluation: carries it out again as it was, records it, and draws it.

Started as `python -m qdgrasp_worker.replay.replay FOLDER` (`qdgrasp_protocol.replay_messages`). The episode
is that of an evaluation, in a world that is recorded. No shortcut is taken: the hand closes to the end where
an evaluation would already know that it misses.
"""

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene, unpack_scene
from qdgrasp_protocol import replay_messages
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.engines import engine_names
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.replay_messages import (
    ANSWER,
    FRAMES,
    REQUEST,
    SCENE,
    ReplayAnswer,
    ReplayFrame,
    ReplayRequest,
)
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_worker.decoder import DecodedGrasps, Decoder
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.episode import EpisodeResult
from qdgrasp_worker.evaluation_protocols import scene_protocol
from qdgrasp_worker.evaluator import contact_columns, make_episode, verdict_in_all
from qdgrasp_worker.filters.pose_filters import TableFilter
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.replay.episode_recorder import (
    REST_SECONDS,
    EpisodeRecorder,
    TimedSnapshot,
    animation,
    placed_snapshot,
    still_snapshot,
)
from qdgrasp_worker.replay.renderer import Renderer, Snapshot, best_view, corners_around, fit_camera, frame_of

OVERSAMPLING = 2  # Pixels that are drawn for each shown one, along each axis
Frames = NDArray[np.uint8]  # (n, rows, columns, 3)
MakeFrames = Callable[[int, int, int], Frames]  # Makes an array of frames, rows and columns


class EpisodeReplay:
    """One evaluation, carried out again; an AssetError if its engine cannot load the scene."""

    def __init__(self, scene: Scene, request: ReplayRequest) -> None:
        self._scene = scene
        self._request = request
        protocol = scene_protocol(scene)
        with closing(make_world(scene, protocol)) as world:
            recorder = EpisodeRecorder(world, scene.gripper)
            episode = make_episode(world, protocol, stops_early=False)
            grasps = requested_grasp(scene, request)
            trial = protocol.trial(grasps[0], request.trial)
            if request.trial == 0 and len(TableFilter(scene)(grasps, np.arange(1))):
                episode.overlaps(trial)
                verdict = EpisodeResult(Outcome.OVERLAP, trial.pose.joints)
            else:
                verdict = episode.run(trial)
        self.snapshots = recorder.snapshots
        with ExitStack() as opened:
            names = engine_names(scene.engine)[1:]
            others = [opened.enter_context(closing(make_world(scene, protocol, name))) for name in names]
            self.verdict = verdict_in_all(verdict, others, protocol, trial, stops_early=False)
        self._robot = parse_robot(Path(), ET.fromstring(scene.gripper.urdf))  # noqa: S314  # the scene's own

    def frames(self) -> list[TimedSnapshot]:
        """The snapshots to show; an InputError if the part that is asked for did not happen."""
        if self._request.what is None:
            still = placed_snapshot if self._request.pregrasp else still_snapshot
            return [TimedSnapshot(still(self.snapshots), REST_SECONDS)]
        return animation(self.snapshots, self._request.what, self.verdict.outcome)

    def render(self, make: MakeFrames) -> ReplayAnswer:
        """Draw into the array that `make` makes; an InputError as in `frames`."""
        request, shown = self._request, self.frames()
        width, height = request.width, request.height
        renderer = Renderer(self._scene, parts=request.parts)
        grasp = shown[0].snapshot if request.pregrasp else still_snapshot(self.snapshots)
        view = request.view or best_view(renderer, grasp)
        corners = corners_around(renderer, [timed.snapshot for timed in shown], grasp)
        camera = fit_camera(corners, *view, width / height)
        frames = make(len(shown), height, width)
        for frame, timed in zip(frames, shown, strict=True):
            renderer.place(timed.snapshot)
            frame[...] = downsample(renderer.draw(camera, OVERSAMPLING * width, OVERSAMPLING * height))
        found = self.verdict
        links, points = contact_columns(found.contacts, self._scene.contact_slots)
        return ReplayAnswer(
            outcome=found.outcome,
            fitness=found.fitness,
            joints=tuple(found.joints),
            contacts=found.finger_links,
            penetration=found.penetration,
            settled=make_pose(list(found.settled[:3]), list(found.settled[3:])),
            contact_links=tuple(links),
            contact_points=tuple(points),
            camera=camera.camera(width, height),
            shots=tuple(self._frame(timed) for timed in shown),
        )

    def hand(self, snapshot: Snapshot) -> replay_messages.Pose:
        """The pose of the hand's base link."""
        frame = self._robot.forward(snapshot.joints, frame_of(snapshot.root))[self._scene.gripper.base_link]
        return make_pose(frame[:3, 3].tolist(), Rotation.from_matrix(frame[:3, :3]).as_quat().tolist())

    def _frame(self, timed: TimedSnapshot) -> ReplayFrame:
        snapshot = timed.snapshot
        return ReplayFrame(
            phase=snapshot.phase,
            step=snapshot.step,
            seconds=timed.seconds,
            hand=self.hand(snapshot),
            object=make_pose(*snapshot.object),
            touches=snapshot.touches,
        )


def requested_grasp(scene: Scene, request: ReplayRequest) -> DecodedGrasps:
    """The requested grasp."""
    genome = np.array([request.genome], dtype=np.float32)
    return Decoder(scene, GIVEN, ObjectSurface(scene))(genome)


def downsample(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The means of squares of `OVERSAMPLING` by `OVERSAMPLING` pixels."""
    places = product(range(OVERSAMPLING), repeat=2)
    parts = [image[row::OVERSAMPLING, column::OVERSAMPLING].astype(np.uint16) for row, column in places]
    total: NDArray[np.uint16] = np.add.reduce(parts)
    return ((total + OVERSAMPLING**2 // 2) // OVERSAMPLING**2).astype(np.uint8)


def make_pose(position: Sequence[float], quaternion: Sequence[float]) -> replay_messages.Pose:
    """The pose of a position [m] and a quaternion xyzw."""
    (x, y, z), (qx, qy, qz, qw) = position, quaternion
    return x, y, z, qx, qy, qz, qw


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def replay_folder(folder: Path) -> None:
    """Replay the evaluation of a folder's request, and write the answer beside it."""

    def make(frames: int, rows: int, columns: int) -> Frames:
        return np.lib.format.open_memmap(
            folder / FRAMES, mode="w+", dtype=np.uint8, shape=(frames, rows, columns, 3)
        )

    with lifetime("qdgrasp-replay") as stop:
        stop.tell(lambda: os._exit(stop.exit_code))  # only a temporary folder is left behind
        request = msgspec.json.decode((folder / REQUEST).read_bytes(), type=ReplayRequest)
        replay = EpisodeReplay(unpack_scene((folder / SCENE).read_bytes()), request)
        try:
            answer = replay.render(make)
            (folder / ANSWER).write_bytes(msgspec.json.encode(answer))
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"The frames do not fit into {folder.parent}: {reason}.") from None


if __name__ == "__main__":
    run_command(app, "qdgrasp-replay")
