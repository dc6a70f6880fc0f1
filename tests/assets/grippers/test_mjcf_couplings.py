"""Joints that tendons, equalities and linkages of MuJoCo couple become followers."""

import pytest
from tests.assets import example_mjcf

from qdgrasp_assets.grippers.hand_model import followers
from qdgrasp_assets.grippers.mjcf import read_mjcf

PULL = '<fixed name="pull"{}><joint joint="J2" coef="{}"/><joint joint="J1" coef="{}"/></fixed>'
TENDON_MOTOR = '<position tendon="pull" kp="1" ctrlrange="0 3.1415" forcerange="-1 1"/>'
JOINT_MOTOR = '<position joint="J2" kp="1" ctrlrange="0 1.57"/>'


def finger(folder, *, tendon="", equality="", actuator=JOINT_MOTOR, spring=""):
    """The finger as URDF, with the notes on it."""
    text = example_mjcf.FINGER.format(tendon=tendon, equality=equality, actuator=actuator, spring=spring)
    return read_mjcf(example_mjcf.write(folder, text))


def only_follower(robot):
    ((name, follower),) = followers(robot).items()
    return name, follower.leader, follower.multiplier, follower.offset


@pytest.mark.parametrize(
    ("couples", "multiplier", "offset"),
    [
        ({"tendon": PULL.format("", 1, 1), "actuator": TENDON_MOTOR}, 1, 0),
        ({"tendon": PULL.format("", 1, 0.5), "actuator": TENDON_MOTOR}, 0.5, 0),
        ({"equality": '<joint joint1="J1" joint2="J2" polycoef="0 0.7 0 0 0"/>'}, 0.7, 0),
        ({"equality": '<joint joint1="J1" joint2="J2" polycoef="0.2 0.7 0 0 0"/>'}, 0.7, 0.2),
        ({"equality": '<joint joint1="J2" joint2="J1" polycoef="0 2 0 0 0"/>'}, 0.5, 0),
        ({"tendon": PULL.format("", 1, -1.25), "equality": '<tendon tendon1="pull"/>'}, 0.8, 0),
        (
            {
                "tendon": PULL.format("", 1, 0.8),
                "equality": '<joint joint1="J1" joint2="J2" polycoef="0 0.5 0 0 0"/>',
                "actuator": TENDON_MOTOR,
            },
            0.5,
            0,
        ),
        ({"tendon": PULL.format(' range="-0.001 0.001" limited="true"', 0.008, -0.008)}, 1, 0),
    ],
    ids=[
        "tendon",
        "arms",
        "equality",
        "offset",
        "other way",
        "length",
        "tendon and equality",
        "tight tendon",
    ],
)
def test_one_joint_follows_the_other(tmp_path, couples, multiplier, offset):
    robot, notes = finger(tmp_path, **couples)
    assert only_follower(robot) == (
        "J1",
        "J2",
        pytest.approx(multiplier, abs=2e-4),
        pytest.approx(offset, abs=2e-4),
    )
    assert any("'J1'" in note and "'J2'" in note for note in notes)


@pytest.mark.parametrize(
    ("motor", "effort"), [("", 0.2), ('forcerange="-1 1"', 0.2), ('forcerange="-0.1 0.1"', 0.1)]
)
def test_the_effort_of_a_joint_is_the_least_that_its_motor_and_itself_state(tmp_path, motor, effort):
    actuator = f'<position joint="J1" kp="1" ctrlrange="0 1.57" {motor}/>'
    robot, _ = finger(tmp_path, actuator=actuator, spring='actuatorfrcrange="-0.2 0.2"')
    assert {joint.name: joint.effort for joint in robot.joints}["J1"] == effort


def test_linkages_are_closed_by_their_followers(tmp_path):
    robot, notes = read_mjcf(example_mjcf.write(tmp_path, example_mjcf.LINKAGE))
    found = followers(robot)
    assert {each.leader for each in found.values()} == {"left_crank"}
    ratios = {name: round(each.multiplier, 3) for name, each in found.items()}
    assert ratios == {
        "left_rocker": 1, "left_pad": -1, "right_crank": 1, "right_rocker": 1, "right_pad": -1,
    }  # fmt: skip
    assert len([note for note in notes if "follow 'left_crank'" in note]) == 1
