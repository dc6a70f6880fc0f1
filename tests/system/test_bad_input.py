"""Bad input: one clear sentence, exit code 2, nothing lost or half-written."""

import re
import socket
from importlib.resources import files
from pathlib import Path

import pytest
import trimesh
from tests.system.commands import SMALL

RUN = ("run", "--gripper", "panda", "--object", "tennis_ball", "--evaluations", "10", "--out", "out")


def sentence(done) -> str:
    """The one sentence that a refused command wrote."""
    assert done.code == 2, (done.code, done.err)
    assert done.out == ""
    assert "Traceback" not in done.err
    lines = [line for line in done.err.splitlines() if line.startswith("qdgrasp: ")]
    assert len(lines) == 1, done.err
    return lines[0]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--gripper", "pandas"), ["gripper", "pandas", "panda"]),
        (("--evaluations", "-5"), ["evaluations", "-5", "at least 1"]),
        (("--method", "cma_mae", "--set", "population=500"), ["population", "15", "cma_mae", "500"]),
        (("--object", "nowhere/part.stl", "--mass", "1"), ["nowhere/part.stl"]),
        (("--scene", "nowhere.toml"), ["No scene can be read at", "nowhere.toml"]),
    ],
)
def test_a_wrong_flag_is_named_with_what_exists(qdgrasp, flags, words):
    said = sentence(qdgrasp(*RUN, *flags))
    assert all(word in said for word in words), said
    assert not (qdgrasp.home / "out").exists()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--mass", "0.3", "--object", "large.stl"), ["millimetre"]),
        (("--mass", "0"), ["mass must be a number greater than 0", "got 0.0"]),
        (("--mass", "1", "--units", "mm"), ["5e-05 x 6e-05 x 7e-05 m", "smaller than what a hand grasps"]),
        (("--mass", "1", "--object", "."), ["'.' is a folder", "`qdgrasp campaign --objects .`"]),
        (("--object", "mug", "--units", "mm"), ["'mug' of the catalog has its own size", "leave --units"]),
    ],
)
def test_an_object_that_cannot_be_is_refused(qdgrasp, flags, words):
    for name, scale in (("part.stl", 1.0), ("large.stl", 1000.0)):
        box = trimesh.creation.box(extents=(0.05 * scale, 0.06 * scale, 0.07 * scale))
        box.export(qdgrasp.home / name)
    part = qdgrasp.home / "part.stl"
    said = sentence(qdgrasp("run", "--gripper", "panda", "--object", part, *flags, "--out", "out"))
    assert all(word in said for word in words), said
    assert not (qdgrasp.home / "out").exists()


@pytest.mark.parametrize(
    ("file", "before", "after", "words"),
    [
        ("panda.toml", "panda_finger_joint2", "panda_finger_joint9", "panda_finger_joint9"),
        ("panda.toml", r"\[jaw\]\naxis = \[0, 1, 0\]\nopening = 0.08\n", "", "two-finger"),
        ("panda.urdf", "finger.obj", "thumb.obj", "thumb.obj"),
        ("panda.urdf", r'"[^"]*finger.obj"', '"empty.obj"', "no triangles"),
    ],
)
def test_a_hand_that_lacks_what_is_asked_for_is_refused(qdgrasp, file, before, after, words):
    """A copy of the Panda hand without a joint, its jaw, a mesh, or the triangles of a mesh."""
    built_in = Path(str(files("qdgrasp_assets") / "grippers"))
    for name in ("panda.toml", "panda.urdf"):
        (qdgrasp.home / name).write_text((built_in / name).read_text())
    (qdgrasp.home / "empty.obj").write_text("o thumb\nv 0 0 0\n")
    spoilt = qdgrasp.home / file
    spoilt.write_text(re.sub(before, after, spoilt.read_text()))
    hand = ("--gripper", qdgrasp.home / "panda.toml", "--method", "antipodal_rand")
    assert words in sentence(qdgrasp(*RUN, *hand))
    assert not (qdgrasp.home / "out").exists()


@pytest.mark.parametrize("command", ["info", "digest", "resume"])
def test_a_folder_without_a_run_is_refused(qdgrasp, command):
    assert "run" in sentence(qdgrasp(command, "nowhere"))
    (qdgrasp.home / "empty").mkdir()
    assert "run" in sentence(qdgrasp(command, "empty"))


def test_a_port_that_is_taken_is_named(qdgrasp):
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        assert endpoint in sentence(qdgrasp("run", *SMALL, "--listen", endpoint, "--out", "out"))
