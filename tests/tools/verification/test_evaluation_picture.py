"""Pictures: marks stand where the camera sees their points, and words are there and fit."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor
from scipy.ndimage import binary_erosion
from tests.coordinator.scenes import jaw, made_scene
from tests.tools.report.test_row_report import run_of

from qdgrasp_protocol.replay_messages import ContactPoint, Phase, ReplayAnswer, ReplayCamera, ReplayFrame
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_tools.rendering.annotations import (
    APPROACH_COLOUR,
    AXIS_COLOURS,
    FINGER_CONTACT_COLOUR,
    OTHER_CONTACT_COLOUR,
    OVERLAP_COLOUR,
)
from qdgrasp_tools.verification import comparison
from qdgrasp_tools.verification.evaluation_picture import (
    LARGEST,
    SMALLEST,
    PictureLayout,
    ReplayCaption,
    replay_pictures,
    write_pictures,
)
from qdgrasp_tools.verification.replay_client import (
    PictureSize,
    ReplayedEvaluation,
    ReplayTarget,
    replay_target,
)

SIZE = PictureSize(640, 560)
LAYOUT = PictureLayout(SIZE)
GREY = 200
"""All of the frame beneath the marks."""
OBJECT, HAND = (0.1, 0.1, 0, 0, 0, 0, 1), (-0.1, 0.0, 0, 0, 0, 0, 1)
POINT, FAR = (0.05, -0.05, 0.0), (-0.05, -0.08, 0.0)


def camera() -> ReplayCamera:
    """Looks down on the origin, x to the right and y up: 40 cm from side to side."""
    width, height = LAYOUT.scene
    matrix = np.diag([5.0, 5.0 * width / height, 1.0, 1.0])
    return ReplayCamera(
        azimuth=0, elevation=90, matrix=tuple(matrix.ravel().tolist()), width=width, height=height
    )


def touch(point: tuple[float, ...], is_finger: bool = True, distance: float = 0.0) -> ContactPoint:
    return ContactPoint(link="left", is_finger=is_finger, point=point, normal=(0, 0, 1), distance=distance)


def replay(*shots: ReplayFrame) -> ReplayedEvaluation:
    width, height = LAYOUT.scene
    frames = np.full((len(shots), height, width, 3), GREY, dtype=np.uint8)
    answer = ReplayAnswer(
        outcome=7,
        fitness=2,
        joints=(0.01, 0.02),
        contacts=2,
        penetration=0.0,
        settled=HAND,
        contact_links=(1,),
        contact_points=(0.0,) * 7,
        camera=camera(),
        shots=shots,
    )
    return ReplayedEvaluation(answer, frames)


def shot(phase: Phase = "closing", *touches: ContactPoint, step: int = 100) -> ReplayFrame:
    return ReplayFrame(phase=phase, step=step, seconds=0.08, hand=HAND, object=OBJECT, touches=touches)


@pytest.fixture
def held(tmp_path: Path) -> ReplayTarget:
    return target(tmp_path, Outcome.HELD)


def target(path: Path, outcome: Outcome) -> ReplayTarget:
    return replay_target(run_of(path / outcome.name, made_scene(), [outcome]).folder, 0)


def drawn(shown: ReplayTarget, *shots: ReplayFrame) -> list[np.ndarray]:
    caption = ReplayCaption.of(shown, shots, [])
    return [np.array(image) for image in replay_pictures(replay(*shots), jaw("jaw"), caption, LAYOUT)]


def has(image: np.ndarray, colour: str, place: np.ndarray, radius: float = 2.0) -> bool:
    """True if a colour is near a place."""
    rows, columns = np.nonzero((image == ImageColor.getrgb(colour)).all(axis=-1))
    return bool((np.hypot(columns + 0.5 - place[0], rows + 0.5 - place[1]) <= radius).any())


def seen(*points: tuple[float, ...]) -> np.ndarray:
    return camera().pixels(np.array(points, dtype=float))


def test_a_contact_is_marked_where_it_is(held: ReplayTarget) -> None:
    (image,) = drawn(held, shot("closing", touch(POINT), touch(FAR, is_finger=False)))
    point, far = seen(POINT, FAR)
    assert has(image, FINGER_CONTACT_COLOUR, point)
    assert has(image, OTHER_CONTACT_COLOUR, far)
    assert not has(image, FINGER_CONTACT_COLOUR, far, radius=8)


def test_an_overlap_of_the_open_hand_is_marked_as_such(held: ReplayTarget) -> None:
    (image,) = drawn(held, shot("placed", touch(POINT, distance=-0.01), touch(FAR, distance=0.001)))
    point, far = seen(POINT, FAR)
    assert has(image, OVERLAP_COLOUR, point)
    assert has(image, FINGER_CONTACT_COLOUR, far)


@pytest.fixture
def turned() -> ReplayFrame:
    """The hand's z goes along the object's x."""
    hand = (-0.1, 0.0, 0.0, 0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    return ReplayFrame(phase="closing", step=100, seconds=1.0, hand=hand, object=OBJECT, touches=())


def test_frames_stand_at_the_hand_and_the_object_with_their_axes(held, turned) -> None:
    (image,) = drawn(held, turned)
    on_x, on_y, hand_y, hand_z = seen((0.12, 0.1, 0), (0.1, 0.12, 0), (-0.1, 0.02, 0), (-0.08, 0, 0))
    assert has(image, AXIS_COLOURS["x"], on_x)
    assert has(image, AXIS_COLOURS["y"], on_y)
    assert has(image, AXIS_COLOURS["y"], hand_y)
    assert has(image, AXIS_COLOURS["z"], hand_z)


def test_the_approach_axis_begins_at_the_palm(held: ReplayTarget, turned: ReplayFrame) -> None:
    (image,) = drawn(held, turned)
    palm, beyond, before = seen((-0.03, 0, 0), (0.0, 0, 0), (-0.05, 0, 0))
    assert has(image, APPROACH_COLOUR, palm)
    assert has(image, APPROACH_COLOUR, beyond)
    assert not has(image, APPROACH_COLOUR, before, radius=5)


@pytest.mark.parametrize(
    "size", [SMALLEST, SIZE, *LARGEST.values(), PictureSize(3840, 240), PictureSize(320, 2160)], ids=str
)
def test_words_fit_below_the_scene(held: ReplayTarget, size: PictureSize) -> None:
    layout = PictureLayout(size)
    assert layout.scene.height > size.height / 2
    assert size.height - 2 > layout.heights[-1] > layout.heights[0] > layout.scene.height
    assert layout.scene.width == size.width


def test_a_caption_says_what_it_is_and_what_came_of_it(held: ReplayTarget) -> None:
    caption = ReplayCaption.of(held, [shot()], [])
    assert caption.title == "jaw on block, grasp 0: held, fitness 2"
    assert caption.lines == (
        "every disturbance was survived; 0 finger links in contact, penetration 0 mm",
        "protocol paper, method me_scs, seed 0; replayed as recorded",
    )


def test_a_caption_says_where_the_replay_differs(held: ReplayTarget) -> None:
    caption = ReplayCaption.of(held, [shot()], ["fitness 1.0 instead of 2.0"])
    assert caption.lines[1].endswith("; but replayed: fitness 1.0 instead of 2.0")


def test_a_caption_calls_a_failure_a_row(tmp_path: Path) -> None:
    caption = ReplayCaption.of(target(tmp_path, Outcome.MISSED), [shot()], [])
    assert caption.title == "jaw on block, row 0: missed, fitness 0"
    assert caption.lines[0] == "no finger touched the object"


@pytest.mark.parametrize(
    ("phase", "step", "words"),
    [
        ("placed", 0, "as it is placed, before the hand closes"),
        ("closing", 48, "closing, 0.20 s"),
        ("closing", 100, "after closing"),
        ("shake z", 120, "shake along z, 0.50 s"),
        ("shake x", 204, "shake about x, 0.85 s"),
    ],
)
def test_a_frame_says_what_happens_in_it(held: ReplayTarget, phase: Phase, step: int, words: str) -> None:
    caption = ReplayCaption.of(held, [shot(), shot("shake z", step=204)], [])
    assert caption.phase(shot(phase, step=step)) == words


def test_no_word_covers_hand_or_object(held: ReplayTarget) -> None:
    """Words change a body only by thin lines that lead to the named parts."""
    shots = [shot(), shot("shake z")]
    width, height = LAYOUT.scene
    rows, columns = np.indices((height, width))
    body = np.hypot(columns - 0.55 * width, rows - 0.5 * height) < 0.3 * height
    made = replay(*shots)
    made.frames[:] = np.where(body, GREY, 255)[:, :, None]
    caption = ReplayCaption.of(held, shots, [])
    bare = PictureLayout(LAYOUT.scene, has_labels=False)
    with_words, without = (
        [np.array(image)[:height] for image in replay_pictures(made, jaw("jaw"), caption, layout)]
        for layout in (LAYOUT, bare)
    )
    for image, other in zip(with_words, without, strict=True):
        changed = (image != other).any(axis=-1)
        assert changed[~body].sum() > 500
        assert not binary_erosion(changed & body, np.ones((3, 3))).any()
        assert binary_erosion(changed & ~body, np.ones((3, 3))).any()


def test_a_picture_without_labels_has_the_size_that_is_asked_for(held: ReplayTarget) -> None:
    assert PictureLayout(SIZE, has_labels=False).scene == SIZE


def film(held: ReplayTarget) -> tuple[list[ReplayFrame], list[Image.Image]]:
    shots = [shot("closing", touch((0.01 * n, 0.0, 0.0)), step=n) for n in range(12)]
    caption = ReplayCaption.of(held, shots, [])
    return shots, list(replay_pictures(replay(*shots), jaw("jaw"), caption, LAYOUT))


def test_a_film_has_all_frames_and_lasts_as_long(held: ReplayTarget, tmp_path: Path) -> None:
    shots, images = film(held)
    write_pictures(tmp_path / "a.gif", iter(images), shots)
    with Image.open(tmp_path / "a.gif") as written:
        assert (written.n_frames, written.size, written.info["duration"]) == (12, tuple(SIZE), 80)
        written.seek(5)
        assert has(np.array(written.convert("RGB")), "white", np.array([600.0, 550.0]))
        assert has(np.array(written.convert("RGB")), FINGER_CONTACT_COLOUR, *seen((0.05, 0.0, 0.0)))


def test_a_picture_is_the_last_frame(held: ReplayTarget, tmp_path: Path) -> None:
    shots, images = film(held)
    write_pictures(tmp_path / "a.png", iter(images), shots)
    with Image.open(tmp_path / "a.png") as written:
        assert np.array_equal(np.array(written), np.array(images[-1]))


def test_a_replay_that_settles_or_touches_elsewhere_differs_from_its_row() -> None:
    answer = replay(shot()).answer
    (row,) = RowShape(2, 2, contact_slots=2).empty(1)
    row["outcome"], row["fitness"], row["contacts"] = answer.outcome, answer.fitness, answer.contacts
    row["joints"], row["settled"], row["contact_links"][:1] = answer.joints, answer.settled, 1
    assert comparison.row_differences(row, comparison.row_with_answer(row, answer)) == {}
    row["settled"][0] += 0.001
    row["contact_points"][0] = 0.02
    found = comparison.row_differences(row, comparison.row_with_answer(row, answer))
    assert found.keys() == {"settled", "contact_points"}


def test_a_row_of_a_run_without_settled_poses_is_not_compared_by_them() -> None:
    answer = replay(shot()).answer
    (row,) = RowShape(2, 2).empty(1)
    row["outcome"], row["fitness"], row["contacts"] = answer.outcome, answer.fitness, answer.contacts
    row["joints"] = answer.joints
    assert comparison.row_differences(row, comparison.row_with_answer(row, answer)) == {}
