"""MJCF files become URDFs that stand, weigh and are shaped as MuJoCo has them."""

import mujoco
import numpy as np
import pytest
from tests.assets import example_mjcf

from qdgrasp_assets.asset_report import examine_urdf
from qdgrasp_assets.grippers.mjcf import is_mjcf, read_mjcf
from qdgrasp_assets.grippers.urdf import parse_origin
from qdgrasp_protocol.errors import AssetError

POSTURES = 20


@pytest.fixture
def crooked(tmp_path):
    """The crooked hand: as MuJoCo's model and as the URDF made of it."""
    path = example_mjcf.write_crooked(tmp_path)
    return mujoco.MjModel.from_xml_path(str(path)), read_mjcf(path)[0]


def bodies(model, robot):
    """Yield each body's number with its link, and the place of the link in the body's frame."""
    for number in range(1, model.nbody):
        first, count = model.body_jntadr[number], model.body_jntnum[number]
        hinges = [j for j in range(first, first + count) if model.jnt_type[j] == 3]
        anchor = model.jnt_pos[hinges[-1]] if hinges else np.zeros(3)
        yield number, model.body(number).name or f"body_{number}", anchor


def body_frame(data, number, anchor):
    frame = np.eye(4)
    frame[:3, :3] = data.xmat[number].reshape(3, 3)
    frame[:3, 3] = data.xpos[number] + frame[:3, :3] @ anchor
    return frame


def test_links_stand_where_mujoco_has_the_bodies(crooked):
    model, robot = crooked
    data, random = mujoco.MjData(model), np.random.default_rng(3)
    for _ in range(POSTURES):
        positions = {}
        for joint in robot.joints:
            if joint.moves:
                positions[joint.name] = data.joint(joint.name).qpos[0] = random.uniform(-1, 1) * 0.5
        mujoco.mj_kinematics(model, data)
        frames = robot.forward(positions)
        for number, link, anchor in bodies(model, robot):
            assert frames[link] == pytest.approx(body_frame(data, number, anchor), abs=1e-9)


def test_links_weigh_what_mujoco_has_and_where(crooked):
    model, robot = crooked
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frames = robot.forward(
        {joint.name: data.joint(joint.name).qpos[0] for joint in robot.joints if joint.moves}
    )
    for number, link, _ in bodies(model, robot):
        inertial = next(each for each in robot.element.findall("link") if each.get("name") == link).find(
            "inertial"
        )
        frame = frames[link] @ parse_origin(robot.path, inertial.find("origin"))
        turn = data.ximat[number].reshape(3, 3)
        moments = [float(inertial.find("inertia").get(key)) for key in ("ixx", "iyy", "izz")]
        assert float(inertial.find("mass").get("value")) == pytest.approx(model.body_mass[number])
        assert frame[:3, 3] == pytest.approx(data.xipos[number], abs=1e-9)
        assert frame[:3, :3] @ np.diag(moments) @ frame[:3, :3].T == pytest.approx(
            turn @ np.diag(model.body_inertia[number]) @ turn.T, abs=1e-12
        )


def test_a_hand_in_the_style_of_menagerie_is_one_that_can_be_used(tmp_path):
    path = example_mjcf.write(tmp_path, example_mjcf.JAW)
    assert is_mjcf(path)
    found, gripper = examine_urdf(path, "jaw")
    assert found.faults == ()
    assert [found.values[key] for key in ("base_link", "fingers", "followers")] == ["palm", 2, 1]
    assert gripper.file.approach_axis == (0.0, 0.0, 1.0)
    assert gripper.file.jaw.opening == pytest.approx(0.08, abs=1e-3)
    assert gripper.on_carrier("paper").urdf.count("<box") == 3  # what is only seen may be missing
    assert any("'thing' left out" in note for note in found.notes)


BODY = '<mujoco><worldbody><body name="a"><geom size="0.01"/>{}</body></worldbody></mujoco>'
MESH = BODY.format('<geom type="mesh" mesh="m"/>').replace(
    "<worldbody>", '<asset><mesh name="m" file="no.stl"/></asset><worldbody>'
)
SLIDE = '<body name="b"><joint name="s" type="slide"/><geom size="0.01"/></body>'
HINGE = '<body name="c"><joint/><geom size="0.01"/></body>'
BALL = '<body name="b"><joint name="ball" type="ball"/><geom size="0.01"/></body>'
ENTITIES = '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa">{}]>'.format(
    "".join(f'<!ENTITY {two} "{f"&{one};" * 10}">' for one, two in zip("abcdefgh", "bcdefghi", strict=True))
)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (MESH, "no.stl"),
        (BODY.format('<joint type="knee"/>'), "invalid keyword: 'knee'"),
        (BODY.format("<body>" * 50_000 + "</body>" * 50_000), "nesting is too deep"),
        (BODY.format("").replace("<w", '<include file="hand.xml"/><w'), "'hand.xml' already included"),
        (BODY.format("").replace("<w", '<include file="none.xml"/><w'), "none.xml"),
        (ENTITIES + BODY.format('<body name="&i;"/>'), "is not XML"),
        (BODY.format('<flexcomp name="f" type="grid"/>'), "soft bodies (<flexcomp>)"),
        (BODY.format("".join("<body/>" for _ in range(1001))), "has 1003 bodies, and at most 1000"),
        (BODY.format("</geom>"), "is not XML"),
    ],
    ids=["mesh", "keyword", "deep", "circle", "include", "entities", "soft", "many", "broken"],
)  # fmt: skip
def test_what_cannot_be_read_is_told_in_a_sentence(tmp_path, text, sentence):
    with pytest.raises(AssetError) as error:
        read_mjcf(example_mjcf.write(tmp_path, text))
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)
    assert "hand.xml'" in str(error.value)


@pytest.mark.parametrize(
    ("inner", "fault"),
    [
        (BALL + HINGE, "the joint 'ball' is of the type 'ball'"),
        (SLIDE, "the joint 's' is prismatic and has no <limit>"),
        ("", "none of its joints moves"),
        (HINGE.replace('name="c"', 'name="c" pos="nan 0 0"'), "holds a number that is not finite"),
    ],
    ids=["ball", "slide", "no joints", "nan"],
)  # fmt: skip
def test_what_the_simulator_does_not_take_is_a_fault_of_the_hand(tmp_path, monkeypatch, inner, fault):
    monkeypatch.chdir(tmp_path)
    found, _ = examine_urdf(example_mjcf.write(tmp_path, BODY.format(inner)), "hand")
    assert fault in "; ".join(found.faults)
    assert [each.name for each in tmp_path.iterdir()] == ["hand.xml"]  # MuJoCo wrote no log
