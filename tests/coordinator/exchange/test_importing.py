"""`qdgrasp import`: files of ours and of others as poses, and every file that is none in one sentence."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation
from tests.coordinator.exchange.conftest import COM as ORIGIN
from tests.coordinator.exchange.conftest import MakeRun
from typer.testing import CliRunner, Result

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.cli.main import app
from qdgrasp_coordinator.counts.poses import read_poses
from qdgrasp_coordinator.exchange import importing, parquet, yaml_text
from qdgrasp_coordinator.exchange.exporting import export
from qdgrasp_coordinator.exchange.harvest import read_grasps
from qdgrasp_coordinator.exchange.importing import Imported
from qdgrasp_coordinator.exchange.things import Thing, hand_of, thing_of
from qdgrasp_coordinator.exchange.told import Unusable
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.outcome import Outcome

COM = np.array([0.01, 0.02, 0.03])
POSITION, TURN = [0.1, -0.2, 0.3], Rotation.from_euler("xyz", [20, -50, 130], degrees=True)
ACROSS = Rotation.from_euler("z", 90, degrees=True)
ISAAC = """format: isaac_grasp
format_version: 1.0
object_frame_link: /World/mug
gripper_frame_link: /World/panda_hand
grasps:
  "grasp 0":
    confidence: 0.7
    position: [0.1, -0.2, 0.3]
    orientation: {{w: {3!r}, xyz: [{0!r}, {1!r}, {2!r}]}}
    cspace_position:
      panda_finger_joint1: 0.02
    pregrasp_cspace_position:
      panda_finger_joint1: 0.04
""".format(*TURN.as_quat().tolist())


def matrix(turn: Rotation = TURN * ACROSS) -> np.ndarray:
    """Of a hand whose axes open along x."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn.as_matrix(), POSITION
    return transform


def acronym(path: Path, transforms: Any, **datasets: Any) -> None:
    """A file as the data set has them."""
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = transforms
        file["grasps/qualities/flex/object_in_gripper"] = np.ones(len(transforms), np.int64)
        file["object/scale"] = 1.0
        for name, value in datasets.items():
            file[name.replace("__", "/")] = value


@pytest.fixture(scope="module")
def panda() -> Callable[..., Imported]:
    """Reads a file for the Panda hand, on an object whose centre of mass is at `COM`."""
    hand = hand_of("panda")
    return lambda path, **settings: importing.read_grasps(path, hand, Thing(COM, 1.0), **settings)


def check_pose(found: Imported, position: Any = POSITION - COM) -> None:
    """The one grasp that all files here tell."""
    np.testing.assert_allclose(found.arrays["base_position"], [position], atol=1e-7)
    turn = Rotation.from_quat(found.arrays["base_quaternion_xyzw"][0]).inv() * TURN
    assert turn.magnitude() < 1e-6


def test_grasps_of_other_tools_in_isaac_yaml_are_read(panda, tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    found = panda(tmp_path / "f.yaml")
    check_pose(found)
    assert found.arrays["confidence"].tolist() == [0.7]
    assert found.arrays["name"].tolist() == ["grasp 0"]
    assert found.notes == ()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("_frame_link", "_frame"),
        ("object_frame_link: /World/mug\ngripper_frame_link: /World/panda_hand\n", ""),
        ("format_version: 1.0", 'format_version: "1.0"'),
        ("    confidence: 0.7\n", ""),
        ("0.1, -0.2", "1e-1, -2.0e-01"),
    ],
    ids=["Isaac ROS", "no frames", "a version in quotes", "no confidence", "exponents"],
)
def test_spellings_of_other_writers_are_read(panda, tmp_path: Path, old: str, new: str) -> None:
    assert old in ISAAC
    (tmp_path / "f.yaml").write_text(ISAAC.replace(old, new))
    check_pose(panda(tmp_path / "f.yaml"))


def test_grasps_of_other_tools_in_acronym_files_are_read(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix()])
    check_pose(panda(tmp_path / "f.h5"))


def test_flat_json_is_read(panda, tmp_path: Path) -> None:
    told = {
        "object": "mug.obj",
        "object_scale": 1.0,
        "transforms": [matrix().tolist()],
        "quality_flex_object_in_gripper": [1],
    }
    (tmp_path / "f.json").write_text(json.dumps(told))
    check_pose(panda(tmp_path / "f.json"))


def test_graspgen_json_is_read(panda, tmp_path: Path) -> None:
    grasps = {"transforms": [matrix().tolist()], "object_in_gripper": [True]}
    (tmp_path / "f.json").write_text(json.dumps({"object": {"file": "a", "scale": 1.0}, "grasps": grasps}))
    check_pose(panda(tmp_path / "f.json"))


def test_poses_may_be_told_at_the_centre_of_mass(panda, tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    check_pose(panda(tmp_path / "f.yaml", frame="com"), POSITION)


def test_another_scale_is_pointed_out(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix()])
    with h5py.File(tmp_path / "f.h5", "a") as file:
        file["object/scale"][()] = 0.5
    (note,) = panda(tmp_path / "f.h5").notes
    assert note == (
        "The file scales its mesh by 0.5, and here it is scaled by 1: "
        "if it is the same mesh, add --scale 0.5."
    )


def test_another_object_and_another_link_are_pointed_out(run: RunFolder, panda, tmp_path: Path) -> None:
    export(run, tmp_path / "f", "parquet")
    assert panda(tmp_path / "f").notes == (
        "The file tells poses of link 'palm' of gripper 'jaw'; they are taken for those of link "
        "'panda_hand' of gripper 'panda'.",
        "The file names joints that gripper 'panda' does not have: left, right; they are left aside.",
        "The object 'block' of the file has its centre of mass elsewhere in its mesh, so it is not the same "
        "object.",
    )
    hand = run.scene().gripper
    found = importing.read_grasps(tmp_path / "f", hand, Thing(COM, 1.0))
    assert [note[:39] for note in found.notes] == ["The object 'block' of the file has its "]


def test_a_pose_stays_where_it_is_in_the_mesh_if_the_centre_of_mass_is_elsewhere(
    run: RunFolder, scene: Scene, tmp_path: Path
) -> None:
    grasps = read_grasps(run)
    export(run, tmp_path / "f", "parquet", min_fitness=0)
    found = importing.read_grasps(tmp_path / "f", scene.gripper, Thing(COM, 1.0))
    np.testing.assert_allclose(found.arrays["base_position"], grasps.poses("mesh")[:, :3] - COM, atol=1e-7)


@pytest.mark.parametrize("name", ["parquet", "isaac", "acronym", "graspgen"])
def test_a_frame_other_than_that_of_the_file_is_refused_and_its_own_changes_nothing(
    run: RunFolder, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "f"
    export(run, out, name)
    file = out / "grasp_data" / "block.json" if out.is_dir() else out
    hand, thing = run.scene().gripper, Thing(COM, 1.0)
    plain, named = (importing.read_grasps(file, hand, thing, frame) for frame in (None, "mesh"))
    np.testing.assert_array_equal(named.arrays["base_position"], plain.arrays["base_position"])
    with pytest.raises(Unusable, match="poses are told in the object's mesh frame; leave --frame out"):
        importing.read_grasps(file, hand, thing, "com")


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"com_in_mesh": ["nan", 0, 0]}, "com_in_mesh in it must be finite"),
        ({"com_in_mesh": [0, 1e300, 0]}, "com_in_mesh in it must be finite, and not more than 1000 m away"),
        ({"object_mass": -3}, "object_mass in it must be a number greater than 0, and is -3"),
        ({"object_mass": "nan"}, "object_mass in it must be a number greater than 0, and is nan"),
        ({"object_scale": 0}, "scale in it must be a number greater than 0, and is 0"),
        ({"object_friction": -0.5}, "object_friction in it must not be negative, and is -0.5"),
        ({"runs": [{"run": "a", "digest": "", "spec": "own?"}]}, "the spec of run 'a' in it cannot be read"),
    ],
)
def test_impossible_numbers_in_what_a_file_of_ours_says_are_refused(
    run: RunFolder, panda, tmp_path: Path, changed: dict[str, object], why: str
) -> None:
    export(run, tmp_path / "f", "isaac")
    told = yaml.safe_load((tmp_path / "f").read_text())
    told["qdgrasp"] |= changed
    (tmp_path / "f").write_text(yaml.safe_dump(told))
    check_refusal(panda, tmp_path / "f", why)


def test_joints_that_the_hand_does_not_have_are_left_aside_with_a_note(panda, tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC.replace("panda_finger_joint1", "finger_joint"))
    found = panda(tmp_path / "f.yaml")
    check_pose(found)
    assert found.notes == (
        "The file names joints that gripper 'panda' does not have: finger_joint; they are left aside.",
    )


def test_a_file_of_another_gripper_is_pointed_out(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix()], gripper__type="robotiq")
    (tmp_path / "f.yaml").write_text(ISAAC.replace("panda_hand", "palm"))
    taken = "; they are taken for those of link 'panda_hand' of gripper 'panda'."
    assert panda(tmp_path / "f.h5").notes == (f"The file tells poses of gripper 'robotiq'{taken}",)
    assert panda(tmp_path / "f.yaml").notes == (f"The file tells poses of link 'palm'{taken}",)


def test_a_graspgen_file_of_a_scaled_object_is_of_that_scale(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(Outcome.HELD, scale=0.001)
    export(run, tmp_path / "out", "graspgen")
    file, hand = tmp_path / "out" / "grasp_data" / "block.json", run.scene().gripper
    assert importing.read_grasps(file, hand, Thing(np.array(ORIGIN), 0.001)).notes == ()


BOMB = "a: &a [x, x]\nb: &b [*a, *a]\nformat: isaac_grasp\n"
POSITION_LINE = "    position: [0.1, -0.2, 0.3]\n"
BAD_YAML = {
    "aliases": (BOMB, "anchors, aliases and tags are not read"),
    "a tag": ("a: !!python/object/apply:os.system [ls]\n", "anchors, aliases and tags are not read"),
    "depth": ("a: " + "[" * 50_000, "nested more than 16 levels deep"),
    "no YAML": ("a: [1, 2\nb: }", "it is not YAML (line 2"),
    "two documents": ("a: b\n---\na: b\n", "it must be one YAML document, and is 2"),
    "a list as a key": ("[a]: b\n", "a key must be a word"),
    "a key twice": ("a: b\na: c\n", "'a' stands there twice"),
    "other YAML": ("a: b\n", "not an Isaac grasp file"),
    "words": ("hello\n", "not an Isaac grasp file"),
    "another version": (ISAAC.replace("1.0\n", "2.0\n", 1), "it is of format version 2.0; 1.0 is read"),
    "no version": (ISAAC.replace("format_version: 1.0\n", ""), "format_version must be a number"),
    "no grasps": (ISAAC[: ISAAC.index("grasps:\n")], "its key 'grasps' must hold grasps by name"),
    "an empty list": (ISAAC[: ISAAC.index("grasps:\n")] + "grasps: {}\n", "there is none in it"),
    "no position": (ISAAC.replace(POSITION_LINE, ""), "grasp 0: position must be 3 numbers"),
    "two numbers": (ISAAC.replace("0.1, -0.2, 0.3", "0.1, -0.2"), "grasp 0: position must be 3 numbers"),
    "a word": (ISAAC.replace("0.1, -0.2", "x, -0.2"), "grasp 0: position must be 3 numbers"),
    "a mapping": (ISAAC.replace("0.1, -0.2", "{a: b}, -0.2"), "grasp 0: position must be 3 numbers"),
    "NaN": (ISAAC.replace("0.1, -0.2", "nan, -0.2"), "of grasp 'grasp 0' its pose holds"),
    "infinity": (
        ISAAC.replace("0.1, -0.2", "1e999, 0"),
        "'grasp 0' its pose holds a number that is not finite",
    ),
    "zero quaternion": (
        ISAAC[: ISAAC.index("    orientation")] + "    orientation: {w: 0.0, xyz: [0, 0, 0]}\n",
        "'grasp 0' its quaternion must be of length 1, and is of length 0",
    ),
    "joints in a list": (
        ISAAC.replace("\n      panda_finger_joint1: 0.02", " [1]"),
        "must hold joints by name",
    ),
    "an infinite joint": (ISAAC.replace(": 0.04", ": .inf"), "joint1 must be a number"),
    "a grasp that is none": (ISAAC + "  other: 3\n", "other: position must be 3 numbers"),
    "very many joints": (
        ISAAC + "".join(f"      joint{number}: 0\n" for number in range(1000)),
        "pregrasp_cspace_position: there are more than 1000 joints",
    ),
    "a long name": (ISAAC.replace("grasp 0", "a" * 201), "a name is longer than 200 letters"),
    "far away": (ISAAC.replace("0.1, -0.2", "1e30, -0.2"), "'grasp 0' its position is more than 1000 m away"),
    "a block that is not ours": (ISAAC + "qdgrasp: {frame: x}\n", "its block 'qdgrasp' cannot be read"),
}


@pytest.mark.parametrize(("text", "why"), BAD_YAML.values(), ids=BAD_YAML)
def test_yaml_that_tells_no_grasps_is_refused_in_a_sentence(
    panda, tmp_path: Path, text: str, why: str
) -> None:
    (tmp_path / "f.yaml").write_text(text)
    check_refusal(panda, tmp_path / "f.yaml", why)


def test_yaml_in_the_pure_parser_is_refused_alike(
    panda, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where PyYAML was built without libyaml."""
    monkeypatch.delattr(yaml, "CSafeLoader")
    (tmp_path / "f.yaml").write_text(ISAAC)
    check_pose(panda(tmp_path / "f.yaml"))
    for text, why in (BAD_YAML["aliases"], BAD_YAML["depth"]):
        (tmp_path / "f.yaml").write_text(text[:4000])
        check_refusal(panda, tmp_path / "f.yaml", why)


def test_a_file_that_is_too_large_is_refused(panda, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_text, "LARGEST", 100)
    (tmp_path / "f.yaml").write_text(ISAAC)
    check_refusal(panda, tmp_path / "f.yaml", "it is larger than")


def check_refusal(read: Callable[..., Imported], path: Path, why: str) -> None:
    with pytest.raises(Unusable) as refused:
        read(path)
    sentence = str(refused.value)
    assert sentence.startswith(f"No grasps can be read from '{path}': ")
    assert why in sentence
    assert "\n" not in sentence


SKEW = np.eye(4) + 0.1 * np.eye(4, k=1)
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
BAD_TRANSFORMS = {
    "none": (np.zeros((0, 4, 4)), "there is none in it"),
    "another shape": (np.zeros((2, 3, 4)), "must be numbers of shape (n, 4, 4)"),
    "a scalar": (np.array([1.0]), "must be numbers of shape (n, 4, 4)"),
    "words": (np.full((1, 4, 4), b"x"), "must be numbers of shape (n, 4, 4)"),
    "NaN": (np.full((1, 4, 4), np.nan), "transform 0 is not a rotation and a translation"),
    "infinity": (np.full((1, 4, 4), np.inf), "transform 0 is not a rotation and a translation"),
    "no rotation": (np.stack([np.eye(4), SKEW]), "transform 1 is not a rotation and a translation"),
    "a mirror": (np.stack([MIRROR]), "transform 0 is not a rotation and a translation"),
    "zeros": (np.zeros((1, 4, 4)), "transform 0 is not a rotation and a translation"),
    "a last row": (np.stack([np.eye(4)]) * 2, "transform 0 is not a rotation and a translation"),
}


@pytest.mark.parametrize(("transforms", "why"), BAD_TRANSFORMS.values(), ids=BAD_TRANSFORMS)
def test_hdf5_with_impossible_transforms_is_refused(panda, tmp_path: Path, transforms, why: str) -> None:
    acronym(tmp_path / "f.h5", transforms)
    check_refusal(panda, tmp_path / "f.h5", why)


BAD_DATASETS = {
    "too few positions": (
        {"gripper__joint_names": ["a", "b"], "grasps__pregrasp_joint_positions": np.zeros((1, 1))},
        "must be numbers of shape (1, 2)",
    ),
    "no names": ({"grasps__pregrasp_joint_positions": np.zeros((1, 1))}, "no dataset 'gripper/joint_names'"),
    "a label": (
        {"gripper__synergy_names": ["a"], "grasps__synergy": [5]},
        "must hold -1 or places in 'gripper/synergy_names'",
    ),
    "another synergy": ({"gripper__synergy_names": ["a"], "grasps__synergy": [0]}, "it names synergy 'a'"),
    "too few numbers": ({"qdgrasp__number": [1, 2]}, "'qdgrasp/number' must be numbers of shape (1)"),
    "words": ({"qdgrasp__about": "{}"}, "what it says of itself cannot be read"),
    "no weight": (
        {"object__mass": -1.0},
        "the object's mass in it must be a number greater than 0, and is -1",
    ),
    "a list": ({"object__friction": [1.0, 2.0]}, "'object/friction' must be a number"),
    "a list of texts": ({"qdgrasp__about": ["{}"]}, "'qdgrasp/about' must be a text"),
    "a long name": (
        {"gripper__synergy_names": ["a" * 201], "grasps__synergy": [0]},
        "its synergies must be of 200 letters at most, and 'aaaaaaaaaaaaaaaaaaaa...' is longer",
    ),
    "wide names": (
        {"gripper__synergy_names": np.array([b"a"], "S100000"), "grasps__synergy": [0]},
        "'gripper/synergy_names' must be a list of names",
    ),
    "a group": ({"qdgrasp__about__x": 1}, "its 'qdgrasp/about' is no dataset"),
}


@pytest.mark.parametrize(("datasets", "why"), BAD_DATASETS.values(), ids=BAD_DATASETS)
def test_hdf5_with_impossible_datasets_is_refused(panda, tmp_path: Path, datasets, why: str) -> None:
    acronym(tmp_path / "f.h5", [matrix()], **datasets)
    check_refusal(panda, tmp_path / "f.h5", why)


def test_hdf5_that_promises_more_than_can_be_read_is_refused_unread(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("grasps/transforms", (10**12, 4, 4), "f8", chunks=(1, 4, 4))
    check_refusal(panda, tmp_path / "f.h5", "it has 1000000000000 grasps; at most 2000000 are read")


def test_small_hdf5_that_promises_much_is_refused_unread(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("grasps/transforms", (10**6, 4, 4), "f8", chunks=(1, 4, 4))
    check_refusal(panda, tmp_path / "f.h5", "its dataset 'grasps/transforms' is far larger than the file")
    acronym(tmp_path / "g.h5", [matrix()])
    with h5py.File(tmp_path / "g.h5", "a") as file:
        file.create_dataset("qdgrasp/about", (2**40,), "f8", chunks=(1,))
    check_refusal(panda, tmp_path / "g.h5", "its dataset 'qdgrasp/about' must be a text")


def test_hdf5_that_points_out_of_itself_is_refused_unread(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "whole.h5", [matrix()])
    (tmp_path / "secret").write_bytes(np.eye(4).tobytes())
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["grasps"] = h5py.ExternalLink("whole.h5", "/grasps")
    with h5py.File(tmp_path / "soft.h5", "w") as file:
        file["grasps"] = h5py.SoftLink("/grasps")
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        outside = [(str(tmp_path / "secret"), 0, 128)]
        file.create_dataset("grasps/transforms", (1, 4, 4), "f8", external=outside)
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        made = h5py.VirtualLayout((1, 4, 4), "f8")
        made[:] = h5py.VirtualSource(tmp_path / "whole.h5", "grasps/transforms", (1, 4, 4))
        file.create_virtual_dataset("grasps/transforms", made)
    for name in ("link.h5", "soft.h5"):
        check_refusal(panda, tmp_path / name, "is a link to elsewhere, which is not followed")
    for name in ("raw.h5", "virtual.h5"):
        check_refusal(panda, tmp_path / name, "lies in another file, which is not read")


def test_hdf5_that_is_no_acronym_file_is_refused(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["a"] = 1
    check_refusal(panda, tmp_path / "f.h5", "it is HDF5, but not an ACRONYM file")


@pytest.mark.parametrize("name", ["acronym", "parquet"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_what_was_cut_off_is_refused(run: RunFolder, panda, tmp_path: Path, name: str, share: float) -> None:
    export(run, tmp_path / "whole", name)
    whole = (tmp_path / "whole").read_bytes()
    (tmp_path / "cut").write_bytes(whole[: int(len(whole) * share)])
    check_refusal(panda, tmp_path / "cut", "it is a damaged")


@pytest.mark.parametrize("name", ["acronym", "parquet", "isaac", "graspgen"])
def test_what_was_damaged_anywhere_is_read_or_refused(run: RunFolder, tmp_path: Path, name: str) -> None:
    export(run, tmp_path / "whole", name)
    file = tmp_path / "whole" / "grasp_data" / "block.json" if name == "graspgen" else tmp_path / "whole"
    hand, random = run.scene().gripper, np.random.default_rng(0)
    sentences = []
    for _ in range(60):
        (tmp_path / "damaged").write_bytes(damaged(file.read_bytes(), random))
        try:
            importing.read_grasps(tmp_path / "damaged", hand, Thing(COM, 1.0))
        except InputError as error:
            sentences.append(str(error))
    assert len(sentences) > 5
    assert "\n" not in "".join(sentences)


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """With a byte or some that are others, gone, or too many."""
    first = int(random.integers(len(content)))
    gone, come = random.integers(0, 30, 2)
    return content[:first] + random.bytes(int(come)) + content[first + int(gone) :]


def test_a_parquet_file_of_others_is_refused(panda, tmp_path: Path) -> None:
    pyarrow.parquet.write_table(pa.table({"a": [1]}), tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "not one that `qdgrasp export` wrote")


def test_a_parquet_file_without_its_columns_is_refused(run: RunFolder, panda, tmp_path: Path) -> None:
    export(run, tmp_path / "whole", "parquet")
    table = pyarrow.parquet.read_table(tmp_path / "whole").drop_columns(["base_to_object"])
    pyarrow.parquet.write_table(table, tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "it is a damaged Parquet file")


def test_a_small_parquet_file_that_stands_for_much_is_refused(
    run: RunFolder, panda, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(run, tmp_path / "f", "parquet")
    monkeypatch.setattr(parquet, "MOST_NUMBERS", 10)
    check_refusal(panda, tmp_path / "f", "it has more than 10 numbers")


def test_a_parquet_file_with_long_words_is_refused(run: RunFolder, panda, tmp_path: Path) -> None:
    export(run, tmp_path / "whole", "parquet")
    table = pyarrow.parquet.read_table(tmp_path / "whole")
    words = pa.array(["a" * 1000] * len(table)).dictionary_encode()
    table = table.set_column(table.schema.get_field_index("synergy"), "synergy", words)
    pyarrow.parquet.write_table(table, tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "its synergies must be of 200 letters at most")


BAD_FILES = {
    "empty": (b"", "it is empty"),
    "blank": (b" \n", "it is empty"),
    "binary": (b"\0\1\2\3", "it is of none of the formats that are read: ACRONYM"),
    "no JSON": (b"{", "it is not JSON with grasps"),
    "another JSON": (b'{"a": 1}', "it is not JSON with grasps"),
    "a ragged list": (b'{"transforms": [[[1, 0], [0]]]}', "its transforms must be of shape (n, 4, 4)"),
    "no transforms": (b'{"transforms": []}', "there is none in it"),
    "too few bits": (
        b'{"transforms": [[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]], "quality_flex_object_in_gripper": []}',
        "its quality must be of shape (1)",
    ),
    "a scale of zero": (
        b'{"transforms": [[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]], "object_scale": 0}',
        "the object's scale in it must be a number greater than 0, and is 0",
    ),
    "deep JSON": (b'{"grasps": ' + b"[" * 100_000, "it is not JSON with grasps"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0", "it is of none of the formats"),
}


@pytest.mark.parametrize(("content", "why"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_file_of_none_of_the_formats_is_refused(panda, tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "f").write_bytes(content)
    check_refusal(panda, tmp_path / "f", why)


def test_a_file_that_is_not_there_is_refused(panda, tmp_path: Path) -> None:
    check_refusal(panda, tmp_path / "none", "no such file or directory")
    check_refusal(panda, tmp_path, "it is a folder; of one that is for GraspGen name the JSON in grasp_data")


def test_a_pipe_is_refused_and_not_waited_for(panda, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "f")
    check_refusal(panda, tmp_path / "f", "it is no ordinary file")


@pytest.mark.parametrize("name", ["csv", "moveit"])
def test_what_is_only_written_is_told_by_its_name(run: RunFolder, panda, tmp_path: Path, name: str) -> None:
    export(run, tmp_path / "f", name)
    check_refusal(panda, tmp_path / "f", "which is not read back; export parquet instead")


def command(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["import", *map(str, arguments)])


def test_the_command_writes_poses_for_evaluate_and_says_how_to_score_them(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    out = tmp_path / "poses.npz"
    done = command(tmp_path / "f.yaml", "--gripper", "panda", "--object", "mug", "-o", out)
    assert done.exit_code == 0, done.exception
    scores = tmp_path / "poses-scores.npz"
    assert done.stdout.splitlines() == [
        f"1 poses written to {out}; this scores them:",
        f"  qdgrasp evaluate --gripper panda --object mug --poses {out} --out {scores}",
    ]
    np.testing.assert_allclose(read_poses(out).positions, [POSITION - thing_of("mug").com_in_mesh], atol=1e-7)


def test_what_a_file_says_of_a_mesh_is_in_the_command_that_scores_it(tmp_path: Path) -> None:
    trimesh.creation.box((0.04, 0.05, 0.06)).export(tmp_path / "box.stl")
    acronym(tmp_path / "f.h5", [matrix()], object__mass=0.25, object__friction=1.0)
    asked = ("--gripper", "panda", "--object", tmp_path / "box.stl", "-o", tmp_path / "p.npz")
    assert "--mass 0.25 --friction 1.0 --poses" in command(tmp_path / "f.h5", *asked).stdout
    (tmp_path / "f.yaml").write_text(ISAAC)
    assert "box.stl --mass KG --poses" in command(tmp_path / "f.yaml", *asked, "--force").stdout


def test_what_is_there_is_replaced_by_force_alone(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    (tmp_path / "poses.npz").write_bytes(b"precious")
    asked = (tmp_path / "f.yaml", "--gripper", "panda", "--object", "mug", "-o", tmp_path / "poses.npz")
    assert isinstance(command(*asked).exception, InputError)
    assert (tmp_path / "poses.npz").read_bytes() == b"precious"
    assert command(*asked, "--force").exit_code == 0
    assert len(read_poses(tmp_path / "poses.npz")) == 1


def test_what_is_no_ordinary_file_is_not_replaced_even_by_force(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "f.yaml")
    for name, what in (("pipe", "a device or pipe"), ("link", "a link"), (".", "a folder")):
        asked = (tmp_path / "f.yaml", "--gripper", "panda", "--object", "mug", "-o", tmp_path / name)
        assert f"is {what}, which is not replaced" in str(command(*asked, "--force").exception)
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "link").is_symlink()


def test_of_a_large_file_it_is_said_that_it_is_being_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("qdgrasp_coordinator.cli.import_.LARGE", 100)
    (tmp_path / "f.yaml").write_text(ISAAC)
    done = command(tmp_path / "f.yaml", "--gripper", "panda", "--object", "mug", "-o", tmp_path / "p.npz")
    assert done.stderr == f"reading {tmp_path / 'f.yaml'}, 0 MiB\n"


def test_a_hand_or_object_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    for gripper, object_ in (("pandaa", "mug"), ("panda", "mugg")):
        asked = (tmp_path / "f.yaml", "--gripper", gripper, "--object", object_, "-o", tmp_path / "p.npz")
        assert "Unknown" in str(command(*asked).exception)
