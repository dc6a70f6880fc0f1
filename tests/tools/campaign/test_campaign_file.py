"""Many runs from one file: their specs and their names."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
import trimesh

from qdgrasp_assets import ycb
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_protocol.errors import (
    ImpossibleValue,
    InputError,
    JawNeeded,
    UnknownKey,
    UnknownName,
    UnusableMeshes,
)
from qdgrasp_protocol.keys import NAME
from qdgrasp_tools.campaign.campaign_file import (
    campaign_of_meshes,
    is_campaign,
    make_campaign,
    read_campaign,
    run_name,
)
from qdgrasp_tools.campaign.object_library import LibraryRules

SHIPPED = sorted((Path(__file__).parents[3] / "deploy" / "campaigns").glob("*.toml"))
CROSS = {"gripper": "panda", "object": ["mug", "bowl"], "method": ["contact_rand", "me_scs"], "seed": [0, 1]}

SHADOW = {"gripper": "shadow", "method": "antipodal_rand"}


def names(source: dict[str, object]) -> list[str]:
    return list(make_campaign(source, "c.toml").runs)


def named(**values: object) -> str:
    whole = {"gripper": "panda", "object": "mug", **values}
    return run_name(full_spec(whole), whole)


class TestCrossing:
    def test_lists_are_crossed_and_the_last_changes_fastest(self) -> None:
        found = names({"cross": [CROSS]})
        assert len(found) == 8
        assert found[:3] == ["panda-mug-contact_rand-s0", "panda-mug-contact_rand-s1", "panda-mug-me_scs-s0"]

    def test_goals_replace_those_of_the_defaults_and_are_no_part_of_a_runs_name(self, tmp_path: Path) -> None:
        file = tmp_path / "c.toml"
        crosses = [{"object": "mug"}, {"object": "bowl", "grasps": 7}]
        source = {"defaults": {"gripper": "panda", "grasps": 5}, "cross": crosses}
        file.write_text(tomli_w.dumps(source))
        as_written = read_campaign(file)
        asked = read_campaign(file, goals={"grasps": 9, "saturation": None})
        assert [spec.grasps for spec in as_written.runs.values()] == [5, 7]
        assert [spec.grasps for spec in asked.runs.values()] == [9, 7]
        assert (
            list(asked.runs) == list(as_written.runs) == ["panda-mug-portfolio-s0", "panda-bowl-portfolio-s0"]
        )
        file.write_text(asked.toml)
        assert read_campaign(file).runs == asked.runs

    def test_the_regions_of_a_spec_are_one_value(self) -> None:
        runs = make_campaign({"cross": [CROSS | {"on": ["handle", "rim"]}]}, "c.toml").runs
        assert {spec.on for spec in runs.values()} == {("handle", "rim")}

    def test_a_run_with_two_budgets_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"'panda-mug-contact_rand-s0' twice, with different values"):
            names({"cross": [CROSS, CROSS | {"evaluations": 7}]})

    def test_each_run_may_have_its_own_seed_for_the_surface_points_too(self, tmp_path: Path) -> None:
        source = {"cross": [CROSS | {"object": "mug", "method": "portfolio", "surface_seed": "seed"}]}
        found = make_campaign(source, "c.toml")
        assert [(spec.seed, spec.surface_seed) for spec in found.runs.values()] == [(0, 0), (1, 1)]
        assert list(found.runs) == ["panda-mug-portfolio-s0", "panda-mug-portfolio-s1-surface1"]
        (tmp_path / "c.toml").write_text(found.toml)
        assert read_campaign(tmp_path / "c.toml").runs == found.runs

    @pytest.mark.parametrize(
        "said",
        [
            {"population": 20},
            {"generations_in_flight": 2},
            {"overlaps": "count"},
        ],
    )
    def test_a_file_that_says_how_much_is_in_flight_gets_that(self, said: dict[str, Any]) -> None:
        cross = {"gripper": "panda", "object": "mug"}
        for source in ({"cross": [cross | said]}, {"defaults": said, "cross": [cross]}):
            (spec,) = make_campaign(source, "c.toml").runs.values()
            assert spec.in_flight is None
        (spec,) = make_campaign({"cross": [cross | {"in_flight": 100}]}, "c.toml").runs.values()
        assert spec.in_flight == 100


class TestObjectives:
    """`aim_for` of runs whose method has an objective."""

    @pytest.mark.parametrize(("defaults", "objective"), [({}, "hold"), ({"aim_for": "touch"}, "touch")])
    def test_the_file_in_a_folder_records_the_objective(self, tmp_path: Path, defaults, objective) -> None:
        cross = {"gripper": "panda", "object": "mug", "method": ["portfolio", "me_scs"]}
        asked = make_campaign({"defaults": defaults, "cross": [cross]}, "c.toml")
        assert {spec.method: spec.aim_for for spec in asked.runs.values()} == {
            "portfolio": objective,
            "me_scs": None,
        }
        assert tomllib.loads(asked.toml)["defaults"]["aim_for"] == objective
        file = tmp_path / "campaign.toml"
        file.write_text(asked.toml)
        assert read_campaign(file).runs == asked.runs

    def test_objectives_are_crossed_for_methods_that_have_one(self) -> None:
        aims, pair = {"aim_for": ["hold", "touch"]}, {"gripper": "panda", "object": "mug"}
        found = names({"defaults": aims, "cross": [pair | {"method": ["portfolio", "me_scs"]}]})
        assert found == ["panda-mug-portfolio-s0", "panda-mug-portfolio-s0-touch", "panda-mug-me_scs-s0"]
        with pytest.raises(ImpossibleValue, match="aim_for must be left out for method 'me_scs'"):
            names({"cross": [pair | aims | {"method": "me_scs"}]})


class TestNames:
    @pytest.mark.parametrize(
        ("values", "more"),
        [
            ({}, ""),
            ({"evaluations": 7}, ""),
            ({"generations_in_flight": 1}, ""),
            ({"generations_in_flight": 2}, "-flight2"),
            ({"aim_for": "hold"}, ""),
            ({"aim_for": "touch"}, "-touch"),
            ({"mutation_sigma": 0.05, "protocol": "released"}, "-sigma0_05-released"),
        ],
    )
    def test_a_name_says_what_is_not_the_default_and_no_budget(self, values, more) -> None:
        assert named(**values) == f"panda-mug-portfolio-s0{more}"

    def test_a_long_name_is_cut_and_still_its_own(self) -> None:
        long = {"gripper": "ref_robotiq_2f", "object": "bleach_cleanser", "method": "antipodal_cma_mae"}
        one, other = (named(**long, population=60, surface_seed=seed) for seed in (1, 2))
        assert one != other
        assert all(NAME.fullmatch(name) for name in (one, other))


def test_scans_are_taken_where_they_are_found_and_stand_ins_are_told_of(monkeypatch) -> None:
    monkeypatch.setattr(ycb, "scan_source", lambda name: "fetched" if name == "ycb_mug" else "absent")
    monkeypatch.setattr(ycb, "check_there", lambda name: None)
    found = make_campaign({"prefer_scans": True, "cross": [CROSS]}, "c.toml")
    assert {spec.object for spec in found.runs.values()} == {"ycb_mug", "bowl"}
    assert found.stand_ins == ("bowl",)


class TestRefusals:
    @pytest.mark.parametrize(
        ("source", "error", "words"),
        [
            ({}, InputError, "asks for no run"),
            ({"cross": []}, InputError, "asks for no run"),
            ({"cross": [CROSS], "defualts": {}}, InputError, "defualts"),
            ({"cross": [CROSS], "defaults": 3}, InputError, "defaults"),
            ({"cross": [CROSS], "objects": {"mug": {"weight": 0.3}}}, InputError, "weight"),
            ({"cross": [CROSS], "prefer_scans": "yes"}, InputError, "prefer_scans"),
            ({"cross": [CROSS, CROSS | {"object": []}]}, ImpossibleValue, "object must be one value, or"),
            ({"cross": [CROSS | {"on": [["handle"], "rim"]}]}, ImpossibleValue, "on must be a list of texts"),
            ({"cross": [CROSS | {"sede": 3}]}, UnknownKey, "sede"),
            ({"cross": [CROSS | {"method": "best"}]}, UnknownName, "best"),
            ({"cross": [CROSS | {"seed": [-1]}]}, ImpossibleValue, "at least 0"),
            ({"cross": [CROSS | {"gripper": "pandaa"}]}, UnknownName, "pandaa"),
            ({"cross": [CROSS | {"object": "mugg"}]}, UnknownName, "mugg"),
            ({"cross": [CROSS | SHADOW]}, JawNeeded, "'shadow' has no"),
            ({"cross": [{"object": "mug"}]}, InputError, "'gripper' is missing"),
        ],
    )
    def test_a_campaign_that_cannot_be_is_one_sentence(self, source, error, words) -> None:
        with pytest.raises(error, match=words):
            make_campaign(source, "c.toml")

    def test_a_file_is_a_campaigns_or_a_runs(self, tmp_path: Path) -> None:
        one, other = tmp_path / "run.toml", tmp_path / "campaign.toml"
        one.write_text('gripper = "panda"\nobject = "mug"\n')
        other.write_text('[[cross]]\ngripper = "panda"\nobject = "mug"\n')
        assert (is_campaign(one), is_campaign(other)) == (False, True)


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_campaign_that_we_ship_can_be_carried_out_on_stand_ins(file, monkeypatch) -> None:
    monkeypatch.setattr(ycb, "scan_source", lambda name: "absent")
    found = read_campaign(file)
    assert found.runs
    assert all(NAME.fullmatch(name) for name in found.runs)


BLOCK = (0.02, 0.03, 0.05)
SAID = {"gripper": ["panda"], "method": None, "evaluations": 50}
WATER, IN_MM = LibraryRules(density=1000.0), LibraryRules(density=1000.0, scale=0.001)


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """A folder with two meshes in millimetres, and other files."""
    folder = tmp_path / "my parts"
    folder.mkdir()
    for name in ("lever arm.stl", "Bügel.ply"):
        trimesh.creation.box(BLOCK).apply_scale(1000).export(folder / name)
    (folder / "README.txt").write_text("mine")
    (folder / "part.mtl").write_text("newmtl none")
    return folder


def test_every_mesh_has_its_run_with_the_mass_that_its_volume_gives_it(parts):
    runs = campaign_of_meshes(parts, IN_MM, SAID).runs
    assert {name: (Path(spec.object).name, spec.mass, spec.scale) for name, spec in runs.items()} == {
        "panda-b-gel-portfolio-s0-physical": ("Bügel.ply", pytest.approx(0.03), 0.001),
        "panda-lever-arm-portfolio-s0-physical": ("lever arm.stl", pytest.approx(0.03), 0.001),
    }
    assert all(Path(spec.object).is_absolute() and spec.evaluations == 50 for spec in runs.values())


def test_all_that_is_wrong_is_named_at_once(parts):
    block = trimesh.creation.box(BLOCK)
    trimesh.Trimesh(block.vertices, block.faces[1:], process=False).apply_scale(1000).export(
        parts / "open.ply"
    )
    (parts / "empty.stl").touch()
    with pytest.raises(UnusableMeshes) as refused:
        campaign_of_meshes(parts, LibraryRules(scale=0.001), SAID)
    first, *others = str(refused.value).split("\n")
    assert first.startswith("4 of 4 meshes cannot be used as they are, and nothing was begun; ")
    told = dict(line.strip().split(": ", 1) for line in others)
    assert told["open.ply"].startswith("it is not closed")
    assert "is empty: the file has no bytes" in told["empty.stl"]
    assert told["Bügel.ply"].startswith("it has no mass; say what it weighs with --mass or --density")


def test_a_folder_without_a_mesh_is_named(tmp_path):
    with pytest.raises(InputError, match=r"There is no mesh in .*: name a folder of files such as \.stl"):
        campaign_of_meshes(tmp_path, WATER, SAID)
    with pytest.raises(InputError, match=r"There is no folder of meshes at '.*nowhere'"):
        campaign_of_meshes(tmp_path / "nowhere", WATER, SAID)


def cross(**objects: dict[str, object]) -> dict[str, object]:
    return {"cross": [{"gripper": "panda", "object": ["mug", "bowl"]}], "objects": objects}


def test_what_is_known_of_an_object_is_no_part_of_a_runs_name_and_comes_before_the_defaults():
    source = cross(mug={"mass": 0.3, "friction": 0.7}) | {"defaults": {"mass": 0.1}}
    runs = make_campaign(source, "c.toml").runs
    assert {name: (spec.mass, spec.friction) for name, spec in runs.items()} == {
        "panda-mug-portfolio-s0": (0.3, 0.7),
        "panda-bowl-portfolio-s0-mass0_1": (0.1, None),
    }
