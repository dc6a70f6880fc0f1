"""`qdgrasp gripper`: a hand of one's own from its URDF to a file that can be used."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.assets import example_hands, example_mjcf
from typer.testing import CliRunner

from qdgrasp_assets.gripper_setup.hand_verdict import HandVerdict
from qdgrasp_assets.grippers.gripper_file import read_gripper_file
from qdgrasp_protocol.errors import AssetError, ImpossibleValue
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_tools.cli import gripper_commands
from qdgrasp_tools.cli.gripper_commands import gripper_app
from qdgrasp_tools.verification import hand_test


def trial_of(hand, closing, outcome):
    """Evaluations of a hand that all ended so, with all of its fingers on the object."""
    links = [link for finger in closing.fingers for link in finger.links]
    rows = RowShape(8, 1, len(links)).empty(9)
    rows["outcome"], rows["contact_links"] = outcome, np.arange(1, 1 + len(links))
    return HandVerdict(closing, hand.file, links, rows)


@pytest.fixture
def gripper(monkeypatch, tmp_path):
    """`qdgrasp gripper` in a folder with the URDF of the jaw; hands are taken to grasp."""
    monkeypatch.setattr(
        gripper_commands, "try_hand", lambda hand, _, closing, __: trial_of(hand, closing, Outcome.HELD)
    )
    monkeypatch.setattr("qdgrasp_tools.rendering.drawings.PORTRAIT_PIXELS", 120)
    monkeypatch.chdir(tmp_path)
    Path("jaw.urdf").write_text(example_hands.JAW_URDF)
    return lambda *words, **more: CliRunner().invoke(gripper_app, words, **more)


@pytest.fixture
def bare(gripper):
    """The URDF of the jaw without the mass of its palm."""
    Path("jaw.urdf").write_text(
        example_hands.JAW_URDF.replace(f'<inertial><mass value="0.5"/>{example_hands.INERTIA}</inertial>', "")
    )


def test_new_writes_a_file_that_check_finds_good(gripper):
    done = gripper("new", "jaw.urdf", "--licence", "CC0")
    assert done.exit_code == 0
    assert "written: jaw.toml" in done.stdout
    assert "next: qdgrasp run --gripper jaw.toml --object mug" in done.stdout
    assert read_gripper_file(Path("jaw.toml")).licence == "CC0"
    found = json.loads(gripper("check", "jaw.toml", "--json").stdout)
    assert (found["faults"], found["base_link"], found["fingers"]) == ([], "palm", 2)


def test_a_new_hand_is_tried_in_the_simulator(gripper, monkeypatch):
    monkeypatch.setattr(gripper_commands, "try_hand", hand_test.try_hand)
    done = gripper("new", "jaw.urdf")
    assert done.exit_code == 0, done.exception
    assert "tested: it holds" in done.stdout


def test_a_hand_that_does_not_grasp_ends_with_its_picture_and_flags(gripper, monkeypatch):
    monkeypatch.setattr(
        gripper_commands, "try_hand", lambda hand, _, closing, __: trial_of(hand, closing, Outcome.MISSED)
    )
    done = gripper("new", "jaw.urdf")
    assert isinstance(done.exception, AssetError)
    assert [flag in str(done.exception) for flag in ("--closed", "--approach-axis", "--base-link")] == [
        True
    ] * 3
    assert "next:" not in done.stdout
    assert Path("jaw.png").is_file()


def test_flags_are_taken_before_guesses(gripper):
    done = gripper(
        "new", "jaw.urdf", "-o", "own.toml", "--base-link", "palm", "--approach-axis", "0", "0", "1",
        "--finger", "left", "--finger", "right", "--open", "slide=-0.01", "--closed", "slide=-0.035",
    )  # fmt: skip
    assert done.exit_code == 0
    file = read_gripper_file(Path("own.toml"))
    assert file.finger_links == ("left", "right")
    assert (file.joints["slide"].open, file.joints["other"].closed) == (-0.01, -0.035)


@pytest.mark.parametrize(
    ("flag", "value", "sentence"),
    [
        ("--closed", "slide", "closed must be JOINT=POSITION, in rad or m, got 'slide'"),
        ("--open", "slide=wide", "open slide must be a number such as 0.05, got 'wide'"),
    ],
)
def test_a_flag_that_means_nothing_is_refused(gripper, flag, value, sentence):
    done = gripper("new", "jaw.urdf", flag, value)
    assert isinstance(done.exception, ImpossibleValue)
    assert str(done.exception).startswith(sentence)
    assert not Path("jaw.toml").exists()


@pytest.mark.usefixtures("bare")
def test_what_cannot_be_used_is_refused_with_all_faults_and_what_helps(gripper):
    done = gripper("new", "jaw.urdf")
    assert isinstance(done.exception, AssetError)
    assert "the link 'palm' is without a mass" in str(done.exception)
    assert "--repair writes a copy" in str(done.exception)
    assert not Path("jaw.toml").exists()


def test_a_repaired_copy_lies_beside_the_file_and_is_what_it_names(gripper, bare):
    assert "repaired: the link 'palm' is given a mass" in gripper("new", "jaw.urdf", "--repair").stdout
    assert read_gripper_file(Path("jaw.toml")).urdf == "jaw_repaired.urdf"
    assert gripper("check", "jaw.toml").exit_code == 0


def test_check_says_all_that_is_wrong_and_ends_so(gripper):
    Path("jaw.urdf").write_text(
        example_hands.JAW_URDF.replace('type="prismatic"', 'type="floating"').replace("0.5", "0", 1)
    )
    Path("jaw.toml").write_text(example_hands.JAW_TOML)
    done = gripper("check", "jaw.toml")
    assert done.stdout.count("WRONG") >= 3
    assert isinstance(done.exception, AssetError)
    assert "\n" not in str(done.exception)


def test_a_hand_of_a_mujoco_file_becomes_a_urdf_beside_its_file(gripper, tmp_path):
    example_mjcf.write(tmp_path, example_mjcf.LINKAGE)
    done = gripper("new", "hand.xml", "--licence", "CC0", "--closed", "left_crank=0.4")
    assert done.exit_code == 0, done.output
    assert "read: 'left_rocker' (1 times it), " in done.stdout
    assert "written: hand_repaired.urdf" in done.stdout
    assert "mended:" not in done.stdout
    assert (read_gripper_file(Path("hand.toml")).urdf, len(list(Path("hand_meshes").iterdir()))) == (
        "hand_repaired.urdf",
        4,
    )
    urdf = Path("hand_repaired.urdf").read_text()
    assert "<!-- It was made from 'hand.xml'. -->" in urdf
    assert 'filename="hand_meshes/left_crank_capsule.obj"' in urdf
    Path("hand.xml").unlink()  # the file and its copy stand alone
    assert gripper("check", "hand.toml").exit_code == 0


def test_what_is_found_bad_is_not_written_and_its_repaired_copy_goes(gripper, bare):
    done = gripper("new", "jaw.urdf", "--open", "slide=-0.02", "--closed", "slide=-0.02", "--repair")
    assert isinstance(done.exception, AssetError)
    assert "WRONG            no joint closes" in done.stdout
    assert str(done.exception) == "The gripper 'jaw.toml' was not written: correct the fault that is listed."
    assert [path.name for path in Path().iterdir()] == ["jaw.urdf"]
