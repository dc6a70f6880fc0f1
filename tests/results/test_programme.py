"""What the table of results is to have, what of it is missing, and in which order that is done."""

import pytest
from tests.benchmarks.results.plan import STAGE, Costs, ordered, stages
from tests.benchmarks.results.programme import Programme, Wanted, chosen, programme
from tests.benchmarks.results.row import Key, Row
from tests.results.make_rows import BEFORE, TODAY, row

from qdgrasp_coordinator.campaigns.campaign import campaign
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec, to_values


def wanted(seed: int = 0, **values: object) -> Wanted:
    spec = {"gripper": "panda", "object": "ycb_mug", "evaluations": 1000} | values
    return Wanted(f"run-s{seed}", RunSpec(seed=seed, **spec))  # type: ignore[arg-type]


def table(*rows: Row) -> dict[Key, Row]:
    return {one.key: one for one in rows}


@pytest.fixture(scope="module")
def known() -> Programme:
    return programme()


class TestFiles:
    def test_every_campaign_of_the_programme_can_be_read_without_its_assets(self, known, monkeypatch) -> None:
        monkeypatch.delenv("QDGRASP_ASSET_PATH", raising=False)
        assert programme().wanted.keys() == known.wanted.keys()

    def test_the_default_is_compared_with_every_method_of_the_paper(self, known) -> None:
        from qdgrasp_coordinator.searches.search import PAPER

        methods = {one.method for one in known.wanted if (one.gripper, one.budget) == ("panda", 5000)}
        assert {method.name for method in PAPER} < methods

    def test_every_comparison_has_the_default_on_the_same_scene_with_as_many_evaluations(self, known) -> None:
        default = RunSpec(gripper="any", object="any").method
        places = {(one[:3], one.seed, one.budget) for one in known.wanted if one.method == default}
        assert {(one[:3], one.seed, one.budget) for one in known.wanted} <= places

    def test_one_spec_has_one_name(self, known) -> None:
        names: dict[str, Key] = {}
        for one in known.wanted.values():
            assert names.setdefault(one.name, one.key._replace(budget=0)) == one.key._replace(budget=0)

    def test_a_campaign_of_full_specs_has_the_same_names(self, known) -> None:
        runs = {one.name: to_values(one.spec) for one in known.wanted.values()}
        assert list(campaign({"cross": list(runs.values())}, "all.toml", here=False).runs) == list(runs)

    def test_a_folder_without_campaigns_is_no_programme(self, tmp_path) -> None:
        with pytest.raises(InputError, match="holds no campaigns"):
            programme(tmp_path)

    def test_an_unknown_campaign_is_told_of(self, known) -> None:
        with pytest.raises(InputError, match=r"No campaign 'log' in the programme; known: .*long"):
            chosen(known, ["log"])


class TestMissing:
    whole = Programme({"one": (wanted(0), wanted(1)), "two": (wanted(1), wanted(1, evaluations=500))})

    def test_a_run_is_wanted_once_however_many_ask(self) -> None:
        assert len(self.whole.wanted) == 3

    def test_what_has_no_row_of_todays_code_is_missing(self) -> None:
        rows = table(row(seed=0, code=BEFORE), row(seed=1))
        assert [one.key for one in self.whole.missing(rows, {TODAY})] == [
            wanted(0).key, wanted(1, evaluations=500).key,
        ]  # fmt: skip

    def test_rows_of_an_accepted_code_are_not(self) -> None:
        rows = table(row(seed=0, code=BEFORE), row(seed=1))
        assert [one.key for one in self.whole.missing(rows, {TODAY, BEFORE})] == [
            wanted(1, evaluations=500).key
        ]

    def test_a_long_run_knows_of_which_shorter_ones_it_has_the_rows(self) -> None:
        assert self.whole.budgets(wanted(1, evaluations=9000).key) == {1000, 500}
        assert self.whole.budgets(wanted(2).key) == set()


class TestOrder:
    def test_what_is_cheaper_comes_first(self) -> None:
        runs = [wanted(0, evaluations=3000), wanted(1), wanted(0, gripper="barrett"), wanted(0)]
        keys = [one.key for one in ordered(runs, Costs([]))]
        assert keys == [runs[3].key, runs[1].key, runs[0].key, runs[2].key]

    def test_costs_are_those_of_the_runs_most_alike(self) -> None:
        costs = Costs([row(cpu_seconds=7.0), row(cpu_seconds=9.0), row("me_scs", cpu_seconds=2.0)])
        asked = row(seed=5).key
        assert costs.seconds(asked) == 8.0
        assert costs.seconds(asked._replace(budget=500)) == 4.0
        assert costs.seconds(asked._replace(object="ycb_bowl")) == 8.0
        assert costs.seconds(asked._replace(method="cma_mae")) == 7.0

    def test_a_hand_that_nobody_knows_costs_something(self) -> None:
        assert Costs([]).seconds(row().key._replace(gripper="claw")) > 0

    def test_a_stage_is_short_and_has_no_name_twice(self) -> None:
        runs = [wanted(seed) for seed in range(3)] + [wanted(0, evaluations=2000)]
        assert [len(part) for part in stages(runs, Costs([]))] == [3, 1]
        dear = Costs([row(cpu_seconds=STAGE)])
        assert [len(part) for part in stages(runs[:3], dear)] == [1, 1, 1]

    def test_stages_lose_nothing(self) -> None:
        runs = [wanted(seed) for seed in range(20)]
        assert [one for part in stages(runs, Costs([row(cpu_seconds=100.0)])) for one in part] == runs
