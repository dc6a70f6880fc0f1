"""The benchmark's own hands and objects: the same on every machine, and usable."""

from collections import Counter
from pathlib import Path

import pytest
from benchmarks.results import assets
from benchmarks.results.__main__ import show
from benchmarks.results.assets import FILES, HANDS, NAME, OBJECTS, asset_name, make_asset
from benchmarks.results.comparison import arms
from benchmarks.results.programme import Programme, programme
from benchmarks.results.work import campaign_source

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.geometry.mesh_io import read_mesh
from qdgrasp_assets.grippers.gripper import read_gripper
from qdgrasp_assets.mesh_check import check_mesh
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.campaign_file import make_campaign

LARGEST = 0.3
"""Side of the largest object [m]."""
DENSITIES = (400.0, 8000.0)
"""From light wood to steel [kg/m3]."""
TWO_FINGERS = {"panda", "robotiq_2f", "xarm", "pr2"}
TUNING = {("panda", name) for name in ("ycb_rubiks_cube", "ycb_mug", "ycb_power_drill")}


@pytest.mark.parametrize("name", OBJECTS)
class TestObjects:
    def test_it_has_the_same_bits_everywhere(self, name: str, tmp_path: Path) -> None:
        make_asset(tmp_path / f"{name}.stl")  # raises for another digest
        assert (tmp_path / f"{name}.stl").read_bytes() == OBJECTS[name].file

    def test_it_can_be_used_as_it_is_and_is_of_a_size_and_weight_to_be_grasped(self, name, tmp_path) -> None:
        file = tmp_path / f"{name}.stl"
        make_asset(file)
        found = check_mesh(file)
        assert (found.faults, found.repairs) == ((), ())
        assert max(read_mesh(file).extents) < LARGEST
        assert DENSITIES[0] < OBJECTS[name].mass / found.volume < DENSITIES[1]


class TestFiles:
    def test_twelve_objects_and_two_hands_have_names_that_no_other_has(self) -> None:
        assert (len(OBJECTS), len(HANDS)) == (12, 2)
        assert OBJECTS.keys().isdisjoint(STAND_INS)
        with pytest.raises(InputError):
            [find_gripper(name) for name in HANDS]

    @pytest.mark.parametrize(
        ("name", "stem"),
        [
            (f"{NAME}/vase.stl", "vase"),
            (f"/home/me/{NAME}/xarm.toml", "xarm"),
            (f"{NAME}/mine.stl", None),
            ("other/vase.stl", None),
            ("vase", None),
        ],
    )
    def test_a_file_is_one_of_the_benchmark_by_its_folder_and_name(self, name: str, stem: str | None) -> None:
        assert asset_name(name) == stem

    def test_a_file_with_another_content_is_made_again(self, tmp_path: Path) -> None:
        file = tmp_path / "knob.stl"
        file.write_bytes(b"another knob")
        make_asset(file)
        assert file.read_bytes() == OBJECTS["knob"].file
        before = file.stat().st_mtime_ns
        make_asset(file)
        assert file.stat().st_mtime_ns == before

    def test_what_this_machine_makes_otherwise_is_refused(self, tmp_path: Path, monkeypatch) -> None:
        monkeypatch.setitem(OBJECTS, "knob", assets.BenchmarkObject(assets.knob, 0.03, "0" * 16))
        with pytest.raises(InputError, match=r"knob.stl comes out otherwise here .*, not 0{16}"):
            make_asset(tmp_path / "knob.stl")


@pytest.mark.slow
@pytest.mark.timeout(3600)  # CoACD takes minutes where others compute too
@pytest.mark.parametrize("name", HANDS)
def test_a_hand_is_the_same_everywhere_and_has_a_jaw(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pybullet_data")
    file = tmp_path / NAME / f"{name}.toml"
    make_asset(file)  # raises for another digest
    assert read_gripper(file, name, file.name).file.jaw is not None


def test_the_digest_of_a_hand_is_of_its_values_its_urdf_and_its_meshes(tmp_path: Path) -> None:
    (tmp_path / "a_meshes").mkdir()
    shape = '<geometry><mesh filename="a_meshes/{}.obj"/></geometry>'
    link = f'<link name="palm"><collision>{shape.format("palm")}</collision></link>'
    files = {
        "a.toml": "palm_offset = 0.1\n",
        "a_mended.urdf": f'<robot name="a">{link}</robot>',
        "a_meshes/palm.obj": "v 0 0 0",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    digests = [assets.hand_digest(tmp_path / "a.toml")]

    (tmp_path / "a.toml").write_text("# a reason in other words\npalm_offset = 0.1\n")
    (tmp_path / "a_meshes" / "skin.obj").write_text("v 1 1 1")
    visual = f"<!-- a remark -->\n<visual>{shape.format('skin')}</visual></link>"
    (tmp_path / "a_mended.urdf").write_text(files["a_mended.urdf"].replace("</link>", visual))
    assert assets.hand_digest(tmp_path / "a.toml") == digests[0]

    for name, text in files.items():
        (tmp_path / name).write_text(text.replace("0", "1").replace('"palm"', '"hand"'))
        digests.append(assets.hand_digest(tmp_path / "a.toml"))
    assert len(set(digests)) == 4


@pytest.fixture(scope="module")
def known() -> Programme:
    return programme()


def specs(known: Programme, campaign: str) -> list[RunSpec]:
    return [one.spec for one in known.campaigns[campaign]]


class TestCampaigns:
    def test_there_are_79_held_out_scenes_of_five_or_four_methods_and_five_seeds(self, known) -> None:
        runs = known.campaigns["grasp-bench-1"]
        scenes = {one.key.scene for one in runs}
        assert len(scenes) == 7 + 12 + 6 * 10
        assert Counter(one.key.scene for one in runs) == {
            scene: 5 * (5 if scene[0] in TWO_FINGERS else 4) for scene in scenes
        }
        assert {hand for hand, *_ in scenes} == TWO_FINGERS | {"allegro", "barrett", "shadow"}

    def test_no_scene_is_held_out_and_tuned_on(self, known: Programme) -> None:
        for campaign in ("grasp-bench-1-tuning", "grasp-bench-1-sweep"):
            assert {one.key.scene[:2] for one in known.campaigns[campaign]} == TUNING
        assert TUNING.isdisjoint(one.key.scene[:2] for one in known.campaigns["grasp-bench-1"])

    def test_each_seed_has_a_cloud_of_its_own_and_an_arm_has_all_seeds(self, known: Programme) -> None:
        for ending, seeds in (("", 5), ("-tuning", 10), ("-sweep", 2)):
            campaign = f"grasp-bench-1{ending}"
            assert all(spec.surface_seed == spec.seed > 0 for spec in specs(known, campaign))
            alike = arms(Programme({"one": known.campaigns[campaign]}), {})
            assert {arm.seeds for arm in alike} == {tuple(range(1, seeds + 1))}

    @pytest.mark.parametrize("campaign", ["grasp-bench-1", "grasp-bench-1-tuning", "grasp-bench-1-sweep"])
    def test_every_evaluation_closes_a_hand_in_mujoco(self, known: Programme, campaign: str) -> None:
        found = {(spec.protocol, spec.engine, spec.overlaps) for spec in specs(known, campaign)}
        assert found == {("physical", "mujoco", "redraw")}

    def test_the_default_method_is_that_of_todays_campaigns(self, known: Programme) -> None:
        one = next(one for one in known.campaigns["grasp-bench-1"] if one.spec.method == "aimed")
        scene = {"gripper": one.spec.gripper, "object": one.spec.object, "seed": 1, "surface_seed": 1}
        said = {"protocol": "physical", "engine": "mujoco", "evaluations": 3000}
        assert [*make_campaign({"cross": [scene | said]}, "c.toml", here=False).runs.values()] == [one.spec]

    def test_two_fingers_have_twice_the_evaluations(self, known: Programme) -> None:
        budgets = {
            (one.key.gripper in TWO_FINGERS, one.key.budget) for one in known.campaigns["grasp-bench-1"]
        }
        assert budgets == {(True, 3000), (False, 1500)}

    def test_made_objects_weigh_what_the_script_says(self, known: Programme) -> None:
        made = [one for one in known.campaigns["grasp-bench-1"] if one.key.object in OBJECTS]
        assert {one.key.object for one in made} == OBJECTS.keys()
        assert not [one for one in made if "mass" in one.key.settings]

    def test_a_name_begins_with_hand_object_method_and_seed(self, known: Programme) -> None:
        for one in known.campaigns["grasp-bench-1"]:
            assert one.name.startswith(f"{'-'.join(one.key[:2])}-{one.key.method}-s{one.key.seed}-")

    def test_all_runs_as_one_campaign_have_the_names_that_they_have(self, known: Programme) -> None:
        runs = {one.name: one.spec for one in known.campaigns["grasp-bench-1"]}
        assert make_campaign(campaign_source(runs.values()), "all.toml", here=False, taken=()).runs == runs

    def test_every_file_is_asked_for(self, known: Programme) -> None:
        named = {name for spec in specs(known, "grasp-bench-1") for name in (spec.gripper, spec.object)}
        assert {name for name in named if asset_name(name)} == {f"{NAME}/{file}" for file in FILES}


def test_a_scene_is_listed_by_its_part_of_the_names(tmp_path, capsys) -> None:
    show(["grasp-bench-1"], ["panda-ycb_bowl"], table=tmp_path / "runs.csv")
    *runs, total = capsys.readouterr().out.splitlines()
    assert len(runs) == 25
    assert all("panda on ycb_bowl" in line for line in runs)
    assert total.startswith("25 runs are missing")
