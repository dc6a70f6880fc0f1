import numpy as np
import pytest

from qdgrasp_assets.urdf import read_urdf


@pytest.fixture
def robot(claw):
    return read_urdf(claw.parent / "claw.urdf")


def test_links_lie_where_origins_and_joints_put_them(robot):
    frames = robot.forward({"bend": np.pi / 2})
    assert robot.root == "mount"
    assert frames["palm"][:3, 3] == pytest.approx([0, 0, 0.1])
    assert frames["finger"][:3, 3] == pytest.approx([0, 0.02, 0.15])
    assert frames["finger"][:3, 0] == pytest.approx([-1, 0, 0])  # yaw of 90 deg, then the joint's own


def test_the_whole_robot_moves_with_its_base(robot):
    base = np.eye(4)
    base[:3, 3] = 1, 2, 3
    moved, still = robot.forward({"bend": 0.4}, base), robot.forward({"bend": 0.4})
    for link in robot.links:
        assert moved[link] == pytest.approx(base @ still[link])


def test_a_subtree_has_its_links_only(robot):
    hand = robot.subtree("palm")
    assert hand.root == "palm"
    assert hand.links == ("palm", "finger")
    assert [joint.name for joint in hand.joints] == ["bend"]
    assert hand.mass == pytest.approx(0.6)
    assert len(robot.element.findall("link")) == 3


def test_a_link_without_a_mass_counts_as_bullet_has_it(robot):
    assert robot.mass == pytest.approx(1.6)


def test_the_bundle_keeps_all_but_visuals_and_mesh_paths(robot):
    element, meshes = robot.bundled()
    assert set(meshes) == {"0_palm.stl"}
    assert not list(element.iter("visual"))
    assert [limit.attrib for limit in element.iter("limit")] == [
        limit.attrib for limit in robot.element.iter("limit")
    ]
    assert list(robot.element.iter("visual"))
