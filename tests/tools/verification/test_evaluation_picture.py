"""Films have every phase at one pace; marks are drawn where the camera sees their points."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor
from tests.coordinator.scenes import made_scene

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.replay_messages import ContactPoint, Phase, ReplayAnswer, Snapshot
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_tools.rendering.drawings import AXIS_COLOURS, STANDOFF_COLOUR, project_point
from qdgrasp_tools.verification import comparison
from qdgrasp_tools.verification.evaluation_picture import (
    FINGER_CONTACT_COLOUR,
    FRAME_SECONDS,
    OTHER_CONTACT_COLOUR,
    OVERLAP_COLOUR,
    REST_SECONDS,
    STEPS_PER_FRAME,
    SnapshotRenderer,
    film_snapshots,
    still_snapshot,
    write_gif,
)

AT_ORIGIN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
ABOVE = (0.04, 0.0, 0.14, 1.0, 0.0, 0.0, 0.0)
"""The jaw's root link, its fingers pointing down."""
CLOSING, SHAKE = 100, 204


def shot(phase: Phase = "closing", step: int = 0, *touches: ContactPoint) -> Snapshot:
    joints = {"left": 0.035, "right": 0.035}
    return Snapshot(phase=phase, step=step, root=ABOVE, joints=joints, object=AT_ORIGIN, touches=touches)


def shots(*phases: tuple[Phase, int]) -> list[Snapshot]:
    """All snapshots of phases with so many steps each."""
    return [shot(phase, step) for phase, steps in phases for step in range(steps + 1)]


def touch(*point: float, is_finger: bool = True, distance: float = 0.0) -> ContactPoint:
    return ContactPoint(link="left", is_finger=is_finger, point=point, normal=(0, 0, 1), distance=distance)


WHOLE = shots(("placed", 0), ("closing", CLOSING), ("shake z", SHAKE), ("shake x", 50))


def test_a_still_is_of_the_hand_after_closing_or_where_it_did_not_close_as_it_was_placed() -> None:
    assert (still_snapshot(WHOLE).phase, still_snapshot(WHOLE).step) == ("closing", CLOSING)
    assert still_snapshot(WHOLE, pregrasp=True).phase == "placed"
    assert still_snapshot(WHOLE[:1]).phase == "placed"


def test_a_film_has_the_last_moment_of_every_phase_and_rests_where_something_ends() -> None:
    film = film_snapshots(WHOLE, "all", Outcome.SHAKEN)
    taken = [(frame.snapshot.phase, frame.snapshot.step) for frame in film]
    assert {("placed", 0), ("closing", CLOSING), ("shake z", SHAKE), ("shake x", 50)} <= set(taken)
    assert list(dict.fromkeys(phase for phase, _ in taken)) == ["placed", "closing", "shake z", "shake x"]
    rests = [place for place, frame in zip(taken, film, strict=True) if frame.seconds == REST_SECONDS]
    assert rests == [("placed", 0), ("closing", CLOSING), ("shake x", 50)]


def test_a_film_has_one_pace_also_where_states_are_farther_apart() -> None:
    sparse = [snapshot for snapshot in WHOLE if snapshot.step % 4 == 0 or snapshot.step == 50]
    for every in (WHOLE, sparse):
        film = film_snapshots(every, "all", Outcome.SHAKEN)
        moving = [frame for frame in film if frame.snapshot.phase == "closing"]
        seconds = sum(frame.seconds for frame in moving[:-1])
        assert seconds == pytest.approx(CLOSING / STEPS_PER_FRAME * FRAME_SECONDS)


def test_a_part_alone_is_shown_and_one_that_did_not_happen_is_refused() -> None:
    film = film_snapshots(WHOLE, "shakes", Outcome.SHAKEN)
    assert {frame.snapshot.phase for frame in film} == {"shake z", "shake x"}
    with pytest.raises(InputError, match="no shakes to show"):
        film_snapshots(WHOLE[:50], "shakes", Outcome.MISSED)


SIZE = (640, 480)


def has(image: Image.Image, colour: str, place: tuple[float, float], radius: float = 2.5) -> bool:
    """True if a colour is near a place."""
    apart = np.abs(np.asarray(image, dtype=int) - ImageColor.getrgb(colour)).max(axis=-1)
    rows, columns = np.nonzero(apart < 40)
    return bool((np.hypot(columns + 0.5 - place[0], rows + 0.5 - place[1]) <= radius).any())


def test_frames_approach_axis_and_contacts_are_drawn_where_they_are() -> None:
    scene, left, right = made_scene(), (0.0, 0.05, 0.05), (0.0, -0.05, 0.05)
    painter = SnapshotRenderer(scene)
    closed = shot("closing", 100, touch(*left), touch(*right, is_finger=False))
    placed = shot("placed", 0, touch(*left, distance=-0.01), touch(*right, distance=0.001))
    camera = painter.fit([closed], (40.0, 20.0), SIZE)

    def seen(*point: float) -> tuple[float, float]:
        return project_point(camera, np.array(point))

    after, before = painter.draw(closed, camera), painter.draw(placed, camera)
    assert after.size == SIZE
    assert has(after, FINGER_CONTACT_COLOUR, seen(*left))
    assert has(after, OTHER_CONTACT_COLOUR, seen(*right))
    assert has(before, OVERLAP_COLOUR, seen(*left))
    assert has(before, FINGER_CONTACT_COLOUR, seen(*right))
    for place, colour in zip(0.03 * np.eye(3), AXIS_COLOURS.values(), strict=True):
        assert has(after, colour, seen(*place))
    palm = 0.14 - scene.gripper.palm_offset
    assert has(after, STANDOFF_COLOUR, seen(0.04, 0.0, palm - 0.055))
    assert not has(after, STANDOFF_COLOUR, seen(0.04, 0.0, palm + 0.03), 5.0)


def test_the_view_shows_both_fingers_and_object() -> None:
    painter = SnapshotRenderer(made_scene())
    azimuth, elevation = painter.best_view(shot())
    assert abs(np.cos(np.radians(azimuth))) > 0.3  # from along y one finger hides the object
    assert 0 < elevation < 90


def test_a_camera_sees_all_of_a_film_but_not_an_object_that_fell() -> None:
    painter, near = SnapshotRenderer(made_scene()), shot()
    fallen = Snapshot(
        phase="pushes", step=9, root=ABOVE, joints=near.joints, object=(0, 0, -9.0, 0, 0, 0, 1), touches=()
    )
    apart = Snapshot(
        phase="pushes", step=9, root=(0.3, *ABOVE[1:]), joints=near.joints, object=AT_ORIGIN, touches=()
    )
    alone, with_fallen, with_apart = (
        painter.fit([near, *others], (40.0, 20.0), SIZE) for others in ([], [fallen], [apart])
    )
    assert with_fallen.step == alone.step
    assert with_apart.step > alone.step
    assert has(
        painter.draw(apart, with_apart), "#4477aa", project_point(with_apart, np.array([0.3, 0, 0.1])), 20
    )


def test_a_film_has_all_frames_lasts_as_long_and_keeps_the_colours_of_marks(tmp_path: Path) -> None:
    frames = [Image.new("RGB", SIZE, (200, 200, 10 * n)) for n in range(12)]
    frames[5].putpixel((3, 3), ImageColor.getrgb(OVERLAP_COLOUR))
    write_gif(tmp_path / "a.gif", frames, [0.08] * 11 + [0.96])
    with Image.open(tmp_path / "a.gif") as written:
        assert (written.n_frames, written.size, written.info["duration"]) == (12, SIZE, 80)
        written.seek(5)
        assert written.convert("RGB").getpixel((3, 3)) == ImageColor.getrgb(OVERLAP_COLOUR)
        written.seek(11)
        assert written.info["duration"] == 960


def test_a_replay_differs_from_its_row_in_the_columns_that_the_row_has() -> None:
    answer = ReplayAnswer(
        outcome=7,
        fitness=2,
        joints=(0.01, 0.02),
        contacts=2,
        penetration=0.0,
        settled=AT_ORIGIN,
        contact_links=(1,),
        contact_points=(0.0,) * 7,
        snapshots=(),
    )
    (row,), (bare,) = RowShape(2, 2, contact_slots=2).empty(1), RowShape(2, 2).empty(1)
    for one in (row, bare):
        one["outcome"], one["fitness"], one["contacts"] = answer.outcome, answer.fitness, answer.contacts
        one["joints"] = answer.joints
    row["settled"], row["contact_links"][:1] = answer.settled, 1
    for one in (row, bare):
        assert comparison.row_differences(one, comparison.row_with_answer(one, answer)) == {}
    row["settled"][0] += 0.001
    row["contact_points"][0] = 0.02
    found = comparison.row_differences(row, comparison.row_with_answer(row, answer))
    assert found.keys() == {"settled", "contact_points"}
