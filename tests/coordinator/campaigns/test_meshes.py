"""A folder of meshes as a campaign: what is known of each, and all that is wrong with any, at once."""

from pathlib import Path

import pytest
import trimesh

from qdgrasp_coordinator.campaigns.campaign import campaign, read_campaign
from qdgrasp_coordinator.campaigns.meshes import Weighing, check_meshes, of_folder
from qdgrasp_protocol.errors import InputError, UnknownKey, UnusableMeshes

BLOCK = (0.02, 0.03, 0.05)
SAID = {"gripper": ["panda"], "method": None, "evaluations": 50}
WATER = Weighing(density=1000.0)


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """A folder with two meshes in millimetres, and files that are none."""
    folder = tmp_path / "my parts"
    folder.mkdir()
    for name in ("lever arm.stl", "Bügel.ply"):
        trimesh.creation.box(BLOCK).apply_scale(1000).export(folder / name)
    (folder / "README.txt").write_text("mine")
    (folder / "part.mtl").write_text("newmtl none")
    return folder


def table(folder: Path, *lines: str) -> None:
    (folder / "masses.csv").write_text("\n".join(("file,mass", *lines)), encoding="utf-8")


def test_every_mesh_has_its_run_with_the_mass_that_the_table_or_its_volume_gives_it(parts):
    table(parts, "lever arm.stl, 0.2")
    runs = of_folder(parts, WATER, 0.001, SAID).runs
    assert {name: (Path(spec.object).name, spec.mass, spec.scale) for name, spec in runs.items()} == {
        "panda-b-gel-aimed-s0": ("Bügel.ply", pytest.approx(0.03), 0.001),
        "panda-lever-arm-aimed-s0": ("lever arm.stl", 0.2, 0.001),
    }
    assert all(Path(spec.object).is_absolute() and spec.evaluations == 50 for spec in runs.values())


def test_the_campaigns_file_asks_for_the_same_runs(parts, tmp_path):
    asked = of_folder(parts, Weighing(mass=0.4), 0.001, SAID)
    file = tmp_path / "campaign.toml"
    file.write_text(asked.toml, encoding="utf-8")
    assert read_campaign(file).runs == asked.runs


def test_all_that_is_wrong_is_named_at_once(parts):
    block = trimesh.creation.box(BLOCK)
    trimesh.Trimesh(block.vertices, block.faces[1:], process=False).apply_scale(1000).export(
        parts / "open.ply"
    )
    (parts / "empty.stl").touch()
    block.apply_scale(1000).export(parts / "lever-arm.obj")
    table(parts, "lever arm.stl,0", "lost.stl,1")
    with pytest.raises(UnusableMeshes) as refused:
        of_folder(parts, Weighing(), 0.001, SAID)
    first, *others = str(refused.value).split("\n")
    assert first.startswith("6 of 6 meshes cannot be used as they are, and nothing was begun; ")
    told = dict(line.strip().split(": ", 1) for line in others)
    assert told["open.ply"].startswith("it is not closed")
    assert "is empty: the file has no bytes" in told["empty.stl"]
    assert told["lever arm.stl"] == "its mass must be more than 0 and at most 1000 kg, got 0"
    assert told["lever-arm.obj"].startswith("its runs would be called as those of 'lever arm.stl'")
    assert told["Bügel.ply"].startswith("it has no mass: say what it weighs with --mass or --density")
    assert told["lost.stl"] == "masses.csv names it, and there is no such mesh"


def test_meshes_in_millimetres_are_told_with_the_flag_that_helps(parts):
    with pytest.raises(UnusableMeshes, match=r"2 of 2 .*\n  .*add --units mm\n  .*add --units mm"):
        of_folder(parts, WATER, None, SAID)


@pytest.mark.parametrize(
    "text", ["", "name,kg\n", "file,mass\nlever arm.stl\n", "file,mass\nlever arm.stl,heavy\n"]
)
def test_a_table_that_is_none_is_described(parts, text):
    (parts / "masses.csv").write_text(text)
    with pytest.raises(InputError, match=r"is no table of masses: it begins with the line `file,mass`"):
        of_folder(parts, WATER, 0.001, SAID)


def test_a_folder_without_a_mesh_is_named(tmp_path):
    with pytest.raises(InputError, match=r"There is no mesh in .*: name a folder of files such as \.stl"):
        of_folder(tmp_path, WATER, None, SAID)
    with pytest.raises(InputError, match=r"There is no folder of meshes at '.*nowhere'"):
        of_folder(tmp_path / "nowhere", WATER, None, SAID)


def cross(**objects: dict[str, object]) -> dict[str, object]:
    return {"cross": [{"gripper": "panda", "object": ["mug", "bowl"]}], "objects": objects}


def test_what_is_known_of_an_object_is_no_part_of_a_runs_name_and_comes_before_the_defaults():
    source = cross(mug={"mass": 0.3, "friction": 0.7}) | {"defaults": {"mass": 0.1}}
    runs = campaign(source, "c.toml").runs
    assert {name: (spec.mass, spec.friction) for name, spec in runs.items()} == {
        "panda-mug-aimed-s0": (0.3, 0.7),
        "panda-bowl-aimed-s0-mass0_1": (0.1, None),
    }


def test_what_a_crossing_says_comes_before_what_is_known():
    source = cross(mug={"mass": 0.3})
    source["cross"][0]["mass"] = [0.1, 0.2]  # type: ignore[index]
    assert [spec.mass for spec in campaign(source, "c.toml").runs.values()] == [0.1, 0.2, 0.1, 0.2]


def test_what_is_known_of_no_object_is_refused():
    with pytest.raises(InputError, match=r"says what is known of 'mugg', which no run grasps"):
        campaign(cross(mugg={"mass": 0.3}), "c.toml")
    with pytest.raises(UnknownKey, match=r"objects\.'mug': unknown key 'weight'.* friction, mass, scale"):
        campaign(cross(mug={"weight": 0.3}), "c.toml")


def test_the_meshes_of_any_campaign_are_read_before_it_is_begun(parts):
    whole = {"gripper": "panda", "object": [str(file) for file in sorted(parts.glob("*.[sp][tl]*"))]}
    good = campaign(
        {"cross": [whole | {"scale": 0.001, "mass": 0.1}, {"gripper": "panda", "object": "mug"}]}, "c"
    )
    check_meshes(good.runs.values())
    with pytest.raises(UnusableMeshes, match=r"^2 of 2 meshes"):
        check_meshes(campaign({"cross": [whole | {"mass": 0.1}]}, "c").runs.values())
    with pytest.raises(UnusableMeshes, match="has no mass"):
        check_meshes(campaign({"cross": [whole | {"scale": 0.001}]}, "c").runs.values())
