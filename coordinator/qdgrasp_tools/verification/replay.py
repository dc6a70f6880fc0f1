"""Replays a recorded evaluation in a process, and draws it: a moment, or a film.

The replay is compared with what is recorded, bit for bit.
"""

import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from PIL import Image

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.platforms import platform_differences
from qdgrasp_coordinator.storage.run_folder import Provenance, RunFolder, provenance
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.process import ProcessExit, ProcessSupervisor, Stop
from qdgrasp_protocol.replay_messages import (
    ANSWER,
    REQUEST,
    SCENE,
    Phase,
    ReplayAnswer,
    ReplayRequest,
    Snapshot,
)
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.grasp_table import to_matrices
from qdgrasp_tools.local.supervisor import GRACE, local_platform
from qdgrasp_tools.rendering.ray_renderer import LayeredImage, ParallelCamera, RayMesh, fit_camera
from qdgrasp_tools.rendering.views import (
    FINGER_HUES,
    STEEL,
    PaintedMesh,
    object_colour,
    object_surface,
    paint_neighbours,
    paint_solid,
    rgb,
)
from qdgrasp_tools.report.run_report import row_at
from qdgrasp_tools.verification import comparison


@dataclass(frozen=True)
class ReplayTarget:
    """A recorded row to replay, with its run and scene."""

    number: int
    row: np.void
    """The row in the shape of its own run."""
    found_by: Provenance
    scene: Scene
    bundle: Bundle

    @property
    def outcome(self) -> Outcome:
        """Outcome of its evaluation."""
        return Outcome(self.row["outcome"])

    @property
    def trial(self) -> int:
        """Number of the trial; 0: the nominal evaluation."""
        return int(self.row["trial"])

    @property
    def genome(self) -> tuple[float, ...]:
        """Genome of the prior `given`, with its very pose."""
        prior = prior_of(self.found_by.spec)
        return tuple(as_given(self.scene, prior, self.row.reshape(1))[0].tolist())


def replay_target(folder: RunFolder, number: int) -> ReplayTarget:
    """Find a row by its number in a folder's journal.

    Raises InputError if there is no such row, or no pose of it to show, and FolderError if the folder cannot
    be read.
    """
    with folder.journal() as journal:
        row = row_at(folder, journal, number)
        found_by = provenance(folder, journal)
        if not row["base_to_object"].any():
            why = "it is a dead end, for which decoding found no pose"
            if row["outcome"] == Outcome.ERROR:
                why = f"its evaluation failed: {journal.errors().get(number, 'why is not recorded')}"
            raise InputError(f"There is nothing of row {number} to show: {why}.")
    return ReplayTarget(number, row, found_by, folder.scene(), folder.bundle())


REPLAY_MODULE = "qdgrasp_worker.replay"
POLL_INTERVAL = 0.05  # seconds between two looks whether it is done


class ReplayFailed(QdgraspError):
    """The process that replays ended without an answer."""

    def __init__(self, death: ProcessExit) -> None:
        super().__init__(f"The process that replays {death.description}. {death.words}".strip())


def replay_evaluation(shown: ReplayTarget, stop: Stop) -> ReplayAnswer | None:
    """Replay a row in a process of its own; None where a signal came first.

    Raises ReplayFailed if its replay failed.
    """
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        folder = Path(name)
        (folder / SCENE).write_bytes(shown.bundle.payload)
        request = ReplayRequest(genome=shown.genome, trial=shown.trial)
        (folder / REQUEST).write_bytes(msgspec.json.encode(request))
        _run_process(folder, stop)
        if stop.is_set:
            return None
        return msgspec.json.decode((folder / ANSWER).read_bytes(), type=ReplayAnswer)


def _run_process(folder: Path, stop: Stop) -> None:
    with ProcessSupervisor(folder, GRACE) as processes:
        processes.start("replay", REPLAY_MODULE, lambda: [str(folder)])
        while not (stop.is_set or (ended := processes.exits())):
            with suppress(subprocess.TimeoutExpired):
                processes.process("replay").wait(POLL_INTERVAL)
        for death in () if stop.is_set else ended:
            if death.exit_code:
                raise ReplayFailed(death)


STEPS_PER_FRAME = 6  # Least number of steps of 1/240 s from one frame to the next
FRAME_SECONDS = 0.08  # Seconds for which a frame of so many steps is shown: 3.2 times slower than simulated
REST_SECONDS = 0.96  # Seconds for which the hand rests before it closes, when it has closed, and at the end
CLOSING: tuple[Phase, ...] = ("placed", "closing", "settling")
"""The phases up to the grasp; those after it disturb it."""


class TimedSnapshot(NamedTuple):
    """A snapshot, and the time for which it is shown."""

    snapshot: Snapshot
    seconds: float


def still_snapshot(snapshots: Sequence[Snapshot]) -> Snapshot:
    """The hand after closing; as it was placed where it did not close."""
    return [snapshot for snapshot in snapshots if snapshot.phase in CLOSING][-1]


def film_snapshots(snapshots: Sequence[Snapshot]) -> list[TimedSnapshot]:
    """The snapshots of a film, in time.

    These are the first and the last of each phase, and between them one every `STEPS_PER_FRAME` steps, or the
    next one after that. Each is shown until the time of the next.
    """
    frames = list[Snapshot]()
    for snapshot, following in zip(snapshots, [*snapshots[1:], None], strict=True):
        is_first = not frames or frames[-1].phase != snapshot.phase
        is_last = following is None or following.phase != snapshot.phase
        if is_first or is_last or snapshot.step - frames[-1].step >= STEPS_PER_FRAME:
            frames.append(snapshot)
    shown = []
    for frame, next_frame in zip(frames, [*frames[1:], None], strict=True):
        seconds = FRAME_SECONDS
        if next_frame and next_frame.phase == frame.phase:
            seconds *= (next_frame.step - frame.step) / STEPS_PER_FRAME
        elif next_frame is None or frame.phase in CLOSING:
            seconds = REST_SECONDS
        shown.append(TimedSnapshot(frame, seconds))
    return shown


AZIMUTHS, ELEVATIONS = range(0, 360, 20), (12, 30)  # The camera's directions that are tried [deg]
PREVIEW_SIZE = (160, 120)  # Columns and rows of a picture whose pixels are only counted
FINGER_HUE, PALM_HUE = rgb(FINGER_HUES[0]), rgb(STEEL)


class SnapshotRenderer:
    """Draws snapshots of a scene: the hand by its collision shapes, the object by its surface."""

    def __init__(self, scene: Scene) -> None:
        hand, fingers = hand_geometry(scene.gripper), scene.gripper.finger_links
        self._robot, self._scene = hand.whole, scene
        self._object, self._margins = object_surface(scene)
        self._links = {
            name: (mesh, FINGER_HUE if name in fingers else PALM_HUE)
            for name, mesh in hand.link_meshes.items()
        }

    def fit(
        self, snapshots: Sequence[Snapshot], view: tuple[float, float], size: tuple[int, int]
    ) -> ParallelCamera:
        """Return a camera that sees hand and object in all snapshots, but not an object that fell.

        `view` is azimuth and elevation about the object's z [deg], `size` width and height [pixels].
        """
        points = []
        for number, snapshot in enumerate(snapshots):
            *hand, target = self._placed(snapshot)
            bodies = [*hand, target] if snapshot.touches or not number else hand
            points += [mesh.vertices for mesh, _ in bodies]
        azimuth, elevation = np.radians(view)
        return fit_camera(np.concatenate(points), azimuth, elevation, size, field=0.0)

    def best_view(self, still: Snapshot) -> tuple[float, float]:
        """Return azimuth and elevation [deg] from which most of both fingers and object is seen."""
        bodies = [(RayMesh(mesh), hue) for mesh, hue in self._placed(still)]

        def score(view: tuple[int, int]) -> float:
            image = LayeredImage(self.fit([still], view, PREVIEW_SIZE))
            for body, hue in bodies:
                hits = body.cast_from(image.camera)
                image.add_solid(hits, np.broadcast_to(hue, hits.points.shape))
            counts = [(image.colour == hue).all(axis=1).sum() for hue in (FINGER_HUE, bodies[-1][1])]
            return float(counts[0]) * float(counts[1])

        azimuth, elevation = max(product(AZIMUTHS, ELEVATIONS), key=score)
        return float(azimuth), float(elevation)

    def draw(self, snapshot: Snapshot, camera: ParallelCamera) -> Image.Image:
        """Draw a snapshot, with neighbours until the grasp is disturbed: then they are taken away."""
        image = LayeredImage(camera)
        *hand, (target, hue) = self._placed(snapshot)
        for mesh, link_hue in hand:
            paint_solid(image, RayMesh(mesh), link_hue, has_shadows=False)
        paint_solid(image, RayMesh(target), hue, self._margins, has_shadows=False)
        if snapshot.phase in CLOSING:
            paint_neighbours(image, self._scene)
        return Image.fromarray(np.rint(255 * image.composed()).astype(np.uint8))

    def _placed(self, snapshot: Snapshot) -> list[PaintedMesh]:
        """All bodies where they are with their colours, the object at the end."""
        root, target = to_matrices(np.array([snapshot.root, snapshot.object], dtype=np.float64))
        frames = self._robot.forward(snapshot.joints, root)
        bodies = [(mesh, frames[link], hue) for link, (mesh, hue) in self._links.items()]
        return [
            (Mesh(mesh.vertices @ frame[:3, :3].T + frame[:3, 3], mesh.faces), hue)
            for mesh, frame, hue in [*bodies, (self._object, target, object_colour(self._scene))]
        ]


PALETTE_FRAMES = 8  # Frames that a film's colours are taken from
PICTURE_SIZE = (640, 560)  # Width and height of a picture or a film [pixels]


def write_evaluation(shown: ReplayTarget, out: OutFile, stop: Stop) -> dict[str, comparison.ComparedValues]:
    """Replay a row and write its picture, or its film if the file is a GIF.

    Returns what the replay found in place of what is recorded, column by column; nothing where they agree,
    and of a dead end, which was not simulated. Raises InputError if the file cannot be written, and
    ReplayFailed if it could not be replayed.
    """
    answer = replay_evaluation(shown, stop)
    if answer is None:
        return {}
    still, is_film = still_snapshot(answer.snapshots), out.path.suffix.lower() == ".gif"
    frames = film_snapshots(answer.snapshots) if is_film else [TimedSnapshot(still, REST_SECONDS)]
    painter = SnapshotRenderer(shown.scene)
    shots = [still, *(frame.snapshot for frame in frames)]
    camera = painter.fit(shots, painter.best_view(still), PICTURE_SIZE)
    images = [painter.draw(frame.snapshot, camera) for frame in frames]
    with out.writing() as made:
        if is_film:
            write_gif(made, images, [frame.seconds for frame in frames])
        else:
            images[0].save(made, format="PNG")
    if shown.outcome is Outcome.DEAD_END:
        return {}
    return comparison.row_differences(shown.row, comparison.row_with_answer(shown.row, answer))


def write_gif(path: Path, images: Sequence[Image.Image], seconds: Sequence[float]) -> None:
    """Write all frames in one set of colours, so that nothing flickers."""
    some = images[:: max(1, len(images) // PALETTE_FRAMES)]
    sheet = Image.fromarray(np.concatenate([np.asarray(image) for image in some]))
    palette = sheet.quantize()
    first, *others = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    ends = np.rint(100 * np.cumsum(seconds)).astype(int)  # a GIF counts in 10 ms
    durations = (10 * np.diff(ends, prepend=0)).tolist()
    first.save(path, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)


def difference_reason(shown: ReplayTarget, differences: dict[str, comparison.ComparedValues]) -> str:
    """Describe the differences, and how this platform differs from that of the row."""
    words = ", ".join(comparison.difference_words(differences))
    recorded = shown.found_by.platform
    unlike = platform_differences(recorded, local_platform())
    made = comparison.PlatformShare(rows=1, platform=recorded, differences=unlike)
    return f"The replay differs from row {shown.number}: {words}. It was recorded on {made.words}."
