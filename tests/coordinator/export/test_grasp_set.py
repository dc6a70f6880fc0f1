"""Grasps as arrays and one by one."""

import numpy as np
import pytest
from tests.coordinator.export.conftest import COM

from qdgrasp_coordinator.export.grasp_set import Grasps, join_grasps, read_run
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome


@pytest.fixture
def grasps(run: RunFolder) -> Grasps:
    return read_run(run)


def test_one_grasp_says_what_the_arrays_say(grasps: Grasps) -> None:
    for place, grasp in enumerate(grasps):
        assert grasp.number == grasps.numbers[place]
        np.testing.assert_array_equal(
            grasp.position, grasps.rows["base_to_object"][place, :3] + np.array(COM)
        )
        np.testing.assert_array_equal(grasp.quaternion_xyzw, grasps.poses("com")[place, 3:])
        np.testing.assert_array_equal(grasp.joints, grasps.rows["joints"][place])
        assert grasp.pregrasp.tolist() == pytest.approx([0.04, 0.04])
        assert (grasp.synergy, grasp.confidence) == ("", grasp.fitness / 2)
        assert np.isnan(grasp.eta)
    assert [grasp.outcome for grasp in grasps] == sorted(2 * [Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD])


def test_a_number_takes_one_and_anything_else_several(grasps: Grasps) -> None:
    assert grasps[-1].number == grasps.numbers[-1]
    for places in (slice(1, 3), np.array([1, 2]), np.arange(6) % 3 == 0):
        some = grasps[places]
        assert some.numbers.tolist() == grasps.numbers[places].tolist()
        assert some.starts.tobytes() == grasps.starts[places].tobytes()
    with pytest.raises(IndexError):
        grasps[6]


def test_parts_lead_back_to_the_whole(grasps: Grasps) -> None:
    again = join_grasps([grasps[:2], grasps[2:2], grasps[2:]])
    assert again.rows.tobytes() == grasps.rows.tobytes()
    assert again.poses("mesh").tobytes() == grasps.poses("mesh").tobytes()


def test_failures_are_there_if_they_are_asked_for(run: RunFolder) -> None:
    every = read_run(run, Outcome.MISSED)
    assert every.rows["outcome"].tolist() == sorted([*range(3, 8)] * 2)
    assert np.count_nonzero(every.is_success) == 6
    assert np.count_nonzero(every.is_grasp) == 4
