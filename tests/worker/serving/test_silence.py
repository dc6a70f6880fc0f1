"""How long a simulator has said nothing, in whatever way time was spent."""

import pytest

from qdgrasp_worker.serving.silence import SLICE, Silence


@pytest.fixture
def silence() -> Silence:
    silence = Silence()
    silence.begin(100.0)
    return silence


def look_again_and_again(silence: Silence, since: float, slices: int, *, is_stopped: bool = False) -> float:
    for number in range(1, slices + 1):
        silence.look(since + number * SLICE, is_stopped=is_stopped)
    return since + slices * SLICE


def test_silence_is_the_time_that_passes(silence):
    now = look_again_and_again(silence, 100.0, 7)
    silence.look(now + SLICE / 2, is_stopped=False)
    assert silence.seconds == 7.5 * SLICE
    assert silence.look_at == now + 1.5 * SLICE


def test_a_word_ends_it(silence):
    now = look_again_and_again(silence, 100.0, 7)
    silence.begin(now)
    assert look_again_and_again(silence, now, 2) == now + 2 * SLICE
    assert silence.seconds == 2 * SLICE


def test_a_worker_that_stood_still_has_missed_one_slice(silence):
    look_again_and_again(silence, 100.0, 2)
    silence.look(1e6, is_stopped=False)
    assert silence.seconds == 3 * SLICE


def test_a_simulator_that_stands_still_is_not_silent(silence):
    now = look_again_and_again(silence, 100.0, 1000, is_stopped=True)
    look_again_and_again(silence, now, 1)
    assert silence.seconds == SLICE


def test_before_anything_is_known_of_a_simulator_it_is_looked_at_at_once():
    silence = Silence()
    assert silence.look_at == 0.0
    silence.look(1e6, is_stopped=False)
    assert (silence.seconds, silence.look_at) == (0.0, 1e6 + SLICE)
