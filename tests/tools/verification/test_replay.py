"""One row with all that it takes to carry its evaluation out again; films have every phase at one pace."""

from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene, restricted_scene
from tests.tools.report.test_run_report import PRIOR, run_of

from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.replay_messages import ContactPoint, Phase, Snapshot
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_tools.rendering.drawings import project_point
from qdgrasp_tools.verification.replay import (
    FRAME_SECONDS,
    REST_SECONDS,
    STEPS_PER_FRAME,
    SnapshotRenderer,
    film_snapshots,
    replay_target,
    still_snapshot,
)

OUTCOMES = [Outcome.OVERLAP, Outcome.HELD, Outcome.DEAD_END, Outcome.ERROR]


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return run_of(tmp_path / "mug", made_scene(), OUTCOMES).folder


@pytest.fixture
def repeated(tmp_path: Path) -> RunFolder:
    """Two successes of a run under the protocol robust; of each three trials are recorded."""
    scene = made_scene()
    rows = RowShape(len(layout(scene, PRIOR)), 2).empty(8)
    rows["index"], rows["trial"] = (0, 1, 0, 0, 0, 1, 1, 1), (0, 0, 1, 2, 3, 1, 2, 3)
    rows["outcome"], rows["base_to_object"][:, 6] = Outcome.HELD, 1
    rows["genome"] = rows["index"][:, None] / 2
    return record(tmp_path / "robust", scene, rows, method="me_scs", protocol="robust")


def test_a_row_stands_for_its_very_pose(folder: RunFolder) -> None:
    found = replay_target(folder, 1)
    assert (found.number, found.outcome, found.trial) == (1, Outcome.HELD, 0)
    assert found.genome == pytest.approx((0.01, 0.02, 0.03, 0, 0, 0, 1))
    assert np.array(found.genome, dtype=np.float32).tobytes() == found.row["base_to_object"].tobytes()


def test_a_trial_is_a_row_too(repeated: RunFolder) -> None:
    found = replay_target(repeated, 6)
    assert (found.number, found.trial, found.row["index"]) == (6, 2, 1)


@pytest.mark.parametrize(("number", "why"), [(2, "a dead end"), (3, "its evaluation failed")])
def test_a_row_without_a_pose_is_refused(folder: RunFolder, number: int, why: str) -> None:
    with pytest.raises(InputError, match=f"There is nothing of row {number} to show: .*{why}"):
        replay_target(folder, number)


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


WHOLE = shots(("placed", 0), ("closing", CLOSING), ("shake z", SHAKE), ("shake x", 50))


def test_a_still_is_of_the_hand_after_closing_or_where_it_did_not_close_as_it_was_placed() -> None:
    assert (still_snapshot(WHOLE).phase, still_snapshot(WHOLE).step) == ("closing", CLOSING)
    assert still_snapshot(WHOLE[:1]).phase == "placed"


def test_a_film_has_the_last_moment_of_every_phase_and_rests_where_something_ends() -> None:
    film = film_snapshots(WHOLE)
    taken = [(frame.snapshot.phase, frame.snapshot.step) for frame in film]
    assert {("placed", 0), ("closing", CLOSING), ("shake z", SHAKE), ("shake x", 50)} <= set(taken)
    assert list(dict.fromkeys(phase for phase, _ in taken)) == ["placed", "closing", "shake z", "shake x"]
    rests = [place for place, frame in zip(taken, film, strict=True) if frame.seconds == REST_SECONDS]
    assert rests == [("placed", 0), ("closing", CLOSING), ("shake x", 50)]


def test_a_film_has_one_pace_also_where_states_are_farther_apart() -> None:
    sparse = [snapshot for snapshot in WHOLE if snapshot.step % 4 == 0 or snapshot.step == 50]
    for every in (WHOLE, sparse):
        film = film_snapshots(every)
        moving = [frame for frame in film if frame.snapshot.phase == "closing"]
        seconds = sum(frame.seconds for frame in moving[:-1])
        assert seconds == pytest.approx(CLOSING / STEPS_PER_FRAME * FRAME_SECONDS)


SIZE = (640, 480)


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
    drawn = np.asarray(painter.draw(apart, with_apart), dtype=float)
    assert drawn.shape == (*SIZE[::-1], 3)
    column, row = project_point(with_apart, np.array([0.3, 0.05, 0.06]))
    red, _, blue = drawn[round(row) - 20 : round(row) + 20, round(column) - 20 : round(column) + 20].T
    assert (blue > red + 40).any()  # a finger


def test_neighbours_are_there_until_the_grasp_is_disturbed() -> None:
    painter, closed = SnapshotRenderer(restricted_scene()), shot()
    camera = painter.fit([closed], (60.0, 20.0), SIZE)
    before, after = (np.asarray(painter.draw(shot(phase), camera)) for phase in ("settling", "shake z"))
    assert (before.min(axis=2) < 250).sum() > 1.2 * (after.min(axis=2) < 250).sum()
