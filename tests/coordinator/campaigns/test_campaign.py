"""Many runs from one file: what is asked for, and how the runs are called."""

from pathlib import Path

import pytest

from qdgrasp_assets import ycb
from qdgrasp_coordinator.campaigns.campaign import campaign, is_campaign, read_campaign, run_name
from qdgrasp_coordinator.runs.preparation import full_spec
from qdgrasp_protocol.errors import ImpossibleValue, InputError, JawNeeded, UnknownKey, UnknownName
from qdgrasp_protocol.keys import NAME

SHIPPED = sorted((Path(__file__).parents[3] / "deploy" / "campaigns").glob("*.toml"))
CROSS = {"gripper": "panda", "object": ["mug", "bowl"], "method": ["contact_rand", "me_scs"], "seed": [0, 1]}


def names(source: dict[str, object]) -> list[str]:
    return list(campaign(source, "c.toml").runs)


def named(**values: object) -> str:
    whole = {"gripper": "panda", "object": "mug", **values}
    return run_name(full_spec(whole), whole)


class TestCrossing:
    def test_lists_are_crossed_and_the_last_changes_fastest(self) -> None:
        found = names({"cross": [CROSS]})
        assert len(found) == 8
        assert found[:3] == [
            "panda-mug-contact_rand-s0",
            "panda-mug-contact_rand-s1",
            "panda-mug-me_scs-s0",
        ]

    def test_defaults_are_of_every_run_and_crossings_overrule_them(self) -> None:
        source = {
            "defaults": {"evaluations": 300, "seed": 5},
            "cross": [CROSS, CROSS | {"object": "banana", "seed": 7}],
        }
        runs = campaign(source, "c.toml").runs
        assert {spec.evaluations for spec in runs.values()} == {300}
        assert "panda-banana-me_scs-s7" in runs

    def test_goals_replace_those_of_the_defaults_and_are_no_part_of_a_runs_name(self, tmp_path: Path) -> None:
        file = tmp_path / "c.toml"
        file.write_text(
            """[defaults]
gripper = "panda"
successes = 5
[[cross]]
object = "mug"
[[cross]]
object = "bowl"
successes = 7
"""
        )
        as_written = read_campaign(file)
        asked = read_campaign(file, goals={"successes": 9, "no_new_cell": None})
        assert [spec.successes for spec in as_written.runs.values()] == [5, 7]
        assert [spec.successes for spec in asked.runs.values()] == [9, 7]
        assert list(asked.runs) == list(as_written.runs) == ["panda-mug-aimed-s0", "panda-bowl-aimed-s0"]
        file.write_text(asked.toml)
        assert read_campaign(file).runs == asked.runs

    def test_a_run_that_is_asked_for_twice_is_one(self) -> None:
        assert names({"cross": [CROSS, CROSS]}) == names({"cross": [CROSS]})

    def test_a_run_with_two_budgets_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"'panda-mug-contact_rand-s0' twice, with different values"):
            names({"cross": [CROSS, CROSS | {"evaluations": 7}]})

    def test_without_a_method_a_run_has_the_default_and_one_generation_in_flight(self) -> None:
        (spec,) = campaign({"cross": [{"gripper": "panda", "object": "mug"}]}, "c.toml").runs.values()
        assert (spec.method, spec.overlaps, spec.population) == ("aimed", "redraw", 50)
        assert spec.generations_in_flight == 1

    def test_the_file_may_ask_for_more_generations_in_flight(self) -> None:
        source = {"cross": [{"gripper": "panda", "object": "mug", "generations_in_flight": [1, 2]}]}
        runs = campaign(source, "c.toml").runs
        assert {name: spec.generations_in_flight for name, spec in runs.items()} == {
            "panda-mug-aimed-s0": 1,
            "panda-mug-aimed-s0-flight2": 2,
        }

    def test_the_folders_file_says_what_was_taken_for_granted(self) -> None:
        found = campaign({"cross": [{"gripper": "panda", "object": "mug"}]}, "c.toml")
        assert 'method = "aimed"' in found.toml
        assert "generations_in_flight = 1" in found.toml

    def test_what_the_method_has_is_filled_in_for_each_run(self) -> None:
        runs = campaign({"cross": [CROSS | {"method": ["me_scs", "cma_mae"]}]}, "c.toml").runs
        assert {spec.method: spec.population for spec in runs.values()} == {"me_scs": 500, "cma_mae": 540}


class TestNames:
    def test_a_name_says_what_is_not_the_default(self) -> None:
        assert named() == "panda-mug-aimed-s0"
        assert named(mutation_sigma=0.05, protocol="released") == "panda-mug-aimed-s0-sigma0_05-released"

    @pytest.mark.parametrize(
        ("method", "usual"),
        [
            ("aimed", {"overlaps": "redraw", "population": 50}),
            ("me_scs", {"overlaps": "count", "population": 500}),
        ],
    )
    def test_what_the_method_has_anyway_is_no_part_of_a_name(self, method, usual) -> None:
        assert named(method=method, **usual) == named(method=method)
        other = named(method=method, overlaps="redraw" if method == "me_scs" else "count")
        assert other != named(method=method)

    def test_a_second_generation_in_flight_is_told_of(self) -> None:
        assert named(generations_in_flight=1) == named()
        assert named(generations_in_flight=2) == "panda-mug-aimed-s0-flight2"

    def test_a_budget_is_no_part_of_a_name(self) -> None:
        assert named(evaluations=7) == named()

    def test_a_long_name_is_cut_and_still_its_own(self) -> None:
        long = {
            "gripper": "ref_robotiq_2f",
            "object": "bleach_cleanser",
            "method": "antipodal_cma_mae",
            "population": 60,
        }
        one, other = named(**long, surface_seed=1), named(**long, surface_seed=2)
        assert one != other
        assert all(NAME.fullmatch(name) for name in (one, other))


class TestScans:
    @pytest.fixture(autouse=True)
    def one_scan(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(ycb, "source", lambda name: "fetched" if name == "ycb_mug" else "absent")
        monkeypatch.setattr(ycb, "check_there", lambda name: None)

    def test_scans_are_taken_where_they_are_found_and_stand_ins_are_told_of(self) -> None:
        found = campaign({"prefer_scans": True, "cross": [CROSS]}, "c.toml")
        assert {spec.object for spec in found.runs.values()} == {"ycb_mug", "bowl"}
        assert (found.scans, found.stand_ins) == (("mug",), ("bowl",))
        assert "no scan found of bowl" in found.words

    def test_stand_ins_stay_where_they_are_asked_for(self) -> None:
        assert "panda-mug-me_scs-s0" in names({"cross": [CROSS]})

    def test_the_folders_file_means_the_same_without_the_scans(self, tmp_path: Path) -> None:
        found = campaign({"prefer_scans": True, "cross": [CROSS]}, "c.toml")
        file = tmp_path / "campaign.toml"
        file.write_text(found.toml)
        assert read_campaign(file).runs == found.runs


class TestRefusals:
    @pytest.mark.parametrize(
        ("source", "error", "words"),
        [
            ({}, InputError, "asks for no run"),
            ({"cross": []}, InputError, "asks for no run"),
            ({"cross": [CROSS], "defualts": {}}, UnknownKey, "defualts"),
            ({"cross": [CROSS], "defaults": 3}, ImpossibleValue, "defaults must be a table"),
            ({"cross": [CROSS], "prefer_scans": "yes"}, ImpossibleValue, "true or false"),
            ({"cross": [CROSS, CROSS | {"object": []}]}, ImpossibleValue, "object must be one value, or"),
            ({"cross": [CROSS | {"sede": 3}]}, UnknownKey, "sede"),
            ({"cross": [CROSS | {"method": "best"}]}, UnknownName, "best"),
            ({"cross": [CROSS | {"seed": [-1]}]}, ImpossibleValue, "at least 0"),
            ({"cross": [CROSS | {"gripper": "pandaa"}]}, UnknownName, "pandaa"),
            ({"cross": [CROSS | {"object": "mugg"}]}, UnknownName, "mugg"),
            (
                {"cross": [CROSS | {"gripper": "shadow", "method": "antipodal_rand"}]},
                JawNeeded,
                "'shadow' has no",
            ),
            ({"cross": [{"object": "mug"}]}, InputError, "'gripper' is missing"),
        ],
    )
    def test_a_campaign_that_cannot_be_is_one_sentence(self, source, error, words) -> None:
        with pytest.raises(error, match=words):
            campaign(source, "c.toml")

    def test_a_file_is_a_campaigns_or_a_runs(self, tmp_path: Path) -> None:
        one, other = tmp_path / "run.toml", tmp_path / "campaign.toml"
        one.write_text('gripper = "panda"\nobject = "mug"\n')
        other.write_text('[[cross]]\ngripper = "panda"\nobject = "mug"\n')
        assert (is_campaign(one), is_campaign(other)) == (False, True)


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_campaign_that_we_ship_can_be_carried_out_on_stand_ins(file, monkeypatch) -> None:
    monkeypatch.setattr(ycb, "source", lambda name: "absent")
    found = read_campaign(file)
    assert found.runs
    assert not found.scans
    assert all(NAME.fullmatch(name) for name in found.runs)
