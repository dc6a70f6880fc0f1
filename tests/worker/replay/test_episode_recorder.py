"""The snapshots that are shown, and their times."""

import pytest

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.replay.episode_recorder import (
    FRAME_SECONDS,
    REST_SECONDS,
    STEPS_PER_FRAME,
    animation,
    still_snapshot,
)
from qdgrasp_worker.replay.renderer import Snapshot

CLOSING, SHAKE = 100, 204


def snapshots(*phases):
    """All snapshots of phases with so many steps each."""
    nowhere = [0.0] * 3, [0.0, 0.0, 0.0, 1.0]
    return [
        Snapshot(phase, step, nowhere, {}, nowhere, ())
        for phase, steps in phases
        for step in range(steps + 1)
    ]


WHOLE = snapshots(("placed", 0), ("closing", CLOSING), ("shake z", SHAKE), ("shake x", 50))


def test_a_still_is_of_the_hand_after_closing():
    assert (still_snapshot(WHOLE).phase, still_snapshot(WHOLE).step) == ("closing", CLOSING)


def test_a_still_of_a_hand_that_does_not_close_is_of_its_place():
    assert still_snapshot(snapshots(("placed", 0))).phase == "placed"


def test_a_film_goes_through_all_phases_in_their_order():
    phases = [take.snapshot.phase for take in animation(WHOLE, "all", Outcome.SHAKEN)]
    assert list(dict.fromkeys(phases)) == ["placed", "closing", "shake z", "shake x"]


def test_a_film_has_the_last_moment_of_every_phase():
    taken = {(take.snapshot.phase, take.snapshot.step) for take in animation(WHOLE, "all", Outcome.SHAKEN)}
    assert {("placed", 0), ("closing", CLOSING), ("shake z", SHAKE), ("shake x", 50)} <= taken


def test_a_film_rests_where_something_ends():
    rests = [
        (take.snapshot.phase, take.snapshot.step)
        for take in animation(WHOLE, "all", Outcome.SHAKEN)
        if take.seconds == REST_SECONDS
    ]
    assert rests == [("placed", 0), ("closing", CLOSING), ("shake x", 50)]


def test_a_film_is_everywhere_as_slow():
    speeds = {
        (take.snapshot.step - before.snapshot.step, before.seconds)
        for before, take in zip(
            *[animation(WHOLE, "shakes", Outcome.SHAKEN)[n:] for n in (0, 1)], strict=False
        )
        if before.snapshot.phase == take.snapshot.phase == "shake z"
    }
    assert speeds == {(STEPS_PER_FRAME, FRAME_SECONDS)}


def test_a_film_of_states_that_are_farther_apart_takes_as_long():
    sparse = [snapshot for snapshot in WHOLE if snapshot.step % 4 == 0 or snapshot.step == 50]
    films = [animation(every, "all", Outcome.SHAKEN) for every in (WHOLE, sparse)]
    assert len(films[1]) < len(films[0])
    for phase in ("placed", "closing", "shake z", "shake x"):
        seconds, others = (sum(t.seconds for t in film if t.snapshot.phase == phase) for film in films)
        assert seconds == pytest.approx(others)
    steps = [take.snapshot.step for take in films[1] if take.snapshot.phase == "closing"]
    assert steps == [*range(0, CLOSING, 8), CLOSING]


@pytest.mark.parametrize(
    ("what", "phases"), [("closing", {"placed", "closing"}), ("shakes", {"shake z", "shake x"})]
)
def test_a_part_alone_is_shown(what, phases):
    assert {take.snapshot.phase for take in animation(WHOLE, what, Outcome.SHAKEN)} == phases


def test_shakes_that_did_not_happen_cannot_be_shown():
    with pytest.raises(InputError) as refused:
        animation(snapshots(("placed", 0), ("closing", 100)), "shakes", Outcome.MISSED)
    assert str(refused.value) == "This evaluation has no shakes to show: its outcome is missed."
