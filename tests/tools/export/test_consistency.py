"""Closed hands lie on the object where files place them, by collision bodies that share nothing with qdgrasp.

`python -m benchmarks.physics.consistency` does the same with many hands and objects.
"""

from pathlib import Path

import numpy as np
import pytest
from tests.tools.export.collision_bodies import MARGIN, Bodies
from tests.tools.export.conftest import evaluated
from tests.tools.export.independent_readers import READERS, ClosedHands, closed_hands

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_tools.export.exporter import FORMATS, export_run

OFF = 3e-4  # Depth from the recorded one, at most [m]
APART = 1e-3  # A contact from the surfaces that touched, at most [m]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Poses of the Panda on a cube."""
    return evaluated(tmp_path_factory.mktemp("consistency") / "run", "panda", "rubiks_cube", 40, "antipodal")


def depths(bodies: Bodies, hands: ClosedHands, poses: np.ndarray) -> np.ndarray:
    """How deep the closed hands are in the object at poses (n, 4, 4) [m]."""
    placed = zip(poses, hands.joints, strict=True)
    return np.array([bodies.depth(bodies.hand(pose, joints)) for pose, joints in placed])


@pytest.mark.parametrize("name", FORMATS)
def test_closed_hands_are_as_deep_in_the_object_as_was_recorded_and_contacts_lie_on_both(run, tmp_path, name):
    export_run(run, tmp_path / "out", name, negatives=0)
    hands = closed_hands(name, READERS[name](tmp_path / "out"))
    bodies = Bodies(run.path / "scene.bundle", MARGIN)
    assert len(hands.poses) > 20
    assert (np.abs(depths(bodies, hands, hands.poses) - hands.penetration) <= OFF).all()
    for pose, joints, contacts in zip(hands.poses, hands.joints, hands.contacts, strict=True):
        assert np.max(bodies.apart(bodies.hand(pose, joints), contacts), initial=0.0) <= APART


def test_a_commanded_pose_does_not_go_with_the_joints_after_closing(run: RunFolder, tmp_path: Path) -> None:
    export_run(run, tmp_path / "out", "parquet")
    read = READERS["parquet"](tmp_path / "out")
    hands, bodies = closed_hands("parquet", read), Bodies(run.path / "scene.bundle", MARGIN)
    assert (np.abs(depths(bodies, hands, read.matrices) - hands.penetration) > OFF).mean() > 0.9
