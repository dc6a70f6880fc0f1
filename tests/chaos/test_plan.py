"""What is done to whom is decided by the seed alone."""

from itertools import islice

import pytest
from tests.chaos.plan import COURSES, DEAD, GAPS, HEAD, STILL, Deed, blows, course, opening

from qdgrasp_coordinator.dispatching.member import GRACE
from qdgrasp_protocol.session import SETTINGS

WORKERS = 4
EVERYBODY = {*HEAD, *(f"worker-{number}" for number in range(WORKERS))}


def first(seed: int, number: int) -> list:
    return list(islice(blows(seed, WORKERS), number))


def test_a_plan_is_a_function_of_its_seed() -> None:
    assert first(7, 200) == first(7, 200)
    assert first(7, 200) != first(8, 200)


@pytest.mark.parametrize("seed", range(20))
def test_the_first_blows_kill_each_kind_and_stop_somebody(seed: int) -> None:
    begun = first(seed, opening(WORKERS))
    killed = {blow.victim.partition("-")[0] for blow in begun if blow.deed is Deed.KILL}
    assert killed == {"worker", *HEAD}
    assert [blow.deed for blow in begun].count(Deed.STOP) == 1


def test_then_every_round_kills_and_stops_everybody() -> None:
    after = first(3, opening(WORKERS) + 2 * len(EVERYBODY))[opening(WORKERS) :]
    assert {(blow.victim, blow.deed) for blow in after} == {(who, deed) for who in EVERYBODY for deed in Deed}


def test_blows_come_at_the_pace_that_is_promised_and_stop_for_longer_than_a_lease() -> None:
    for blow in first(1, 500):
        assert GAPS[0] <= blow.after <= GAPS[1]
        low, high = DEAD if blow.deed is Deed.KILL else STILL
        assert low <= blow.seconds <= high
    assert STILL[0] > SETTINGS["transport/link/tx/lease"] / 1000 + GRACE


def test_ten_seeds_disturb_every_kind_of_run() -> None:
    assert {course(seed) for seed in range(10)} == set(COURSES)
    assert course(4).spec(4, 50).protocol == "robust"
