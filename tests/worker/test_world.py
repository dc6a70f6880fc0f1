"""The world in Bullet: loading, motion, independent episodes, and output."""

import tempfile

import numpy as np
import pytest
from tests.common import with_gripper

from qdgrasp_assets.catalog import GRIPPERS
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, SHAKES, TARGET_STEPS, TrialSetup

FAR = TrialSetup(HandPose([1.0, 1.0, 1.0], [0.5, 0.5, 0.5, 0.5], [0.04, 0.04], NO_SYNERGY))
LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
TABLE = {
    "z": [0.014, 0.054, 0.120, 0.175, 0.204, 0.206, 0.181, 0.131, 0.062, 0.016, -0.005, -0.003],
    "x": [0.457, 0.648, 0.728, 0.762, 0.054, -0.434, -0.638, -0.724, -0.302, -0.126, -0.053, -0.022],
}
"""The Panda's motion in the public code's shakes, every 17 steps [m, rad]."""


def close_hand(world, synergy=NO_SYNERGY):
    world.close_fingers(synergy)
    for _ in range(CLOSING_STEPS):
        world.step()


def shaken(world, shake):
    """The place of the shaken joint after every 17 steps."""
    index = next(
        world._hand.moving[axis.name] for axis in world._gripper.carrier if axis.shake == shake.joint
    )
    places = []
    for target in shake.targets:
        world.shake_to(target, shake)
        for step in range(1, TARGET_STEPS + 1):
            world.step()
            if step % 17 == 0:
                places += world._hand.positions([index])
    return places


@pytest.mark.parametrize("gripper", sorted(path.stem for path in GRIPPERS.glob("*.toml")))
def test_in_paper_every_empty_hand_shakes_as_the_panda_is_tabled(gripper, make_scene, request):
    if gripper.startswith("ref_"):
        request.getfixturevalue("asset_path")
    scene = make_scene(gripper, "rubiks_cube", "paper")
    world = BulletShakenWorld(scene)
    world.reset(FAR, world.opened)
    close_hand(world)
    for shake in SHAKES:
        peak = max(TABLE[shake.joint])
        np.testing.assert_allclose(shaken(world, shake), TABLE[shake.joint], atol=0.1 * peak)
    world.close()


def test_loading_leaves_no_files_and_no_words_on_the_console(cube, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    BulletShakenWorld(cube).close()
    assert list(tmp_path.iterdir()) == []
    seen = capfd.readouterr()
    assert (seen.out, seen.err) == ("", "")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"finger_links": ("thumb",)}, r"no finger link 'thumb'. It has: .*panda_leftfinger"),
        ({"meshes": {}}, r"Bullet cannot load a body"),
        ({"meshes": {"../escape.stl": b""}}, r"'../escape.stl' does not"),
        ({"urdf": "<robot>"}, r"Bullet cannot load a body"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else None,
)
def test_a_hand_that_cannot_be_loaded_is_an_asset_error(change, message, cube, capfd):
    with pytest.raises(AssetError, match=message):
        BulletShakenWorld(with_gripper(cube, **change))
    assert capfd.readouterr().out == ""
