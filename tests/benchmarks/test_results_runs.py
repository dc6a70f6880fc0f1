"""The runs of the table of results: planned, carried out, and read."""

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import single_run
from benchmarks.results import drawn_grasps, work
from benchmarks.results.assets import NAME
from benchmarks.results.measure import code_of, finished_rows
from benchmarks.results.paper_claims import CAMPAIGN as CLAIMS
from benchmarks.results.paper_claims import SIGMA_GRID
from benchmarks.results.programme import STAGE, Costs, Programme, Wanted, chosen, ordered, programme, stages
from benchmarks.results.table import Key, Row
from benchmarks.results.work import Store
from msgspec.structs import replace
from tests.benchmarks.test_results_table import BEFORE, TODAY, row
from tests.coordinator.recorded_runs import SHAPE, random_rows

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup
from qdgrasp_coordinator.scheduler.run_plan import full_spec, row_shape
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.journal_schema import JournalIdentity
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_tools.campaign.campaign_file import make_campaign
from qdgrasp_tools.campaign.campaign_folder import begin_campaign
from qdgrasp_tools.local.supervisor import LocalJobConfig

BUNDLE = pack_scene(build_scene(RunSpec(gripper="panda", object="tennis_ball")))
ROWS = random_rows(300)
CODE = {"code": TODAY * 4, "numpy": "2"}


def record(path: Path, rows: Rows = ROWS, platform: dict[str, str] = CODE, **settings: Any) -> RunFolder:
    """A run's folder with these rows, in blocks of ten."""
    values = {"gripper": "panda", "object": "tennis_ball", "method": "me_rand", "population": 10}
    spec = RunSpec(**{**values, "evaluations": 300, "overlaps": "count", **settings})  # type: ignore[arg-type]
    return record_run(path, rows, spec, SHAPE, platform)


def record_run(
    path: Path, rows: Rows, spec: RunSpec, shape: RowShape, platform: dict[str, str] = CODE
) -> RunFolder:
    folder = RunFolder.create(path, spec, BUNDLE)
    with JournalWriter.create(path, JournalIdentity("run", to_toml(spec), BUNDLE.digest, shape)) as journal:
        journal.set_platform(platform)
        journal.begin_epoch(1, 0.0)
        for first in range(0, len(rows), 10):
            part = rows[first : first + 10]
            journal.append(
                JournalSlice(first, part, float(np.sum(part["outcome"] >= Outcome.DROPPED))), 1, 1.0
            )
    return folder


def rows_of(path: Path, *budgets: int) -> list[Row]:
    return list(finished_rows(path, lambda asked: {asked.budget, *budgets}, ReferenceLookup()))


class TestHarvest:
    def test_a_finished_run_has_a_row(self, tmp_path) -> None:
        record(tmp_path / "run")
        (row,) = rows_of(tmp_path / "run")
        assert (row.code, row.evaluations, row.proposals) == (TODAY, 300, 0)
        assert row.grasps >= row.robust > 0
        assert 0 < (row.mean_best or 0) <= 2
        assert row.success_ms == pytest.approx(1000.0)  # read from the blocks

    def test_the_code_of_a_row_is_that_of_its_engine_too(self, tmp_path) -> None:
        platform = CODE | {"mujoco_code": "a" * 64}
        in_bullet = record(tmp_path / "bullet", platform=platform)
        in_mujoco = record(tmp_path / "mujoco", platform=platform, engine="mujoco", protocol="physical")
        (first,), (second,) = (rows_of(folder.path) for folder in (in_bullet, in_mujoco))
        assert first.code == TODAY
        assert second.code not in (TODAY, code_of(CODE | {"mujoco_code": "b" * 64}, "mujoco"))
        assert code_of(platform, "mujoco") == second.code

    def test_a_longer_run_has_the_row_of_the_shorter_one(self, tmp_path) -> None:
        record(tmp_path / "long")
        record(tmp_path / "short", ROWS[:200], evaluations=200)
        (short,) = rows_of(tmp_path / "short")
        part, whole = rows_of(tmp_path / "long", 200)
        assert (part.budget, whole.budget) == (200, 300)
        assert replace(part, wall_seconds=short.wall_seconds) == short

    def test_an_unfinished_run_has_the_rows_of_what_it_has_spent_and_none_of_its_own(self, tmp_path) -> None:
        record(tmp_path / "run", evaluations=301)
        assert rows_of(tmp_path / "run") == []
        assert [row.budget for row in rows_of(tmp_path / "run", 200, 900)] == [200]

    def test_a_budget_ends_with_a_counted_row_when_overlaps_are_redrawn(self, tmp_path) -> None:
        record(tmp_path / "run", evaluations=1000, overlaps="redraw")
        (row,) = rows_of(tmp_path / "run", 50)
        assert row.evaluations == row.simulated == 50


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A real run under `physical` in MuJoCo."""
    values = {"gripper": "panda", "object": "tennis_ball", "method": "antipodal_rand", "evaluations": 25}
    spec = full_spec({**values, "population": 25, "protocol": "physical", "engine": "mujoco"})
    rows = single_run.run(spec).rows
    path = tmp_path_factory.mktemp("drawn") / "run"
    return record_run(path, rows, spec, row_shape(build_scene(spec), prior_of(spec)))


class TestDrawnGrasps:
    def test_the_first_grasp_that_holds_in_a_cell_is_drawn_and_none_twice(self) -> None:
        rows = random_rows(300)
        found = drawn_grasps.drawn(rows, seed=3, number=40)
        assert len(found) == 40
        assert (found["outcome"] == Outcome.HELD).all()
        places = cells(found["base_to_object"][:, :3])
        assert len(np.unique(places, axis=0)) == 40
        held = rows[rows["outcome"] == Outcome.HELD]
        firsts = {
            tuple(place): i for i, place in reversed([*enumerate(cells(held["base_to_object"][:, :3]))])
        }
        assert [held[firsts[tuple(place)]] == one for place, one in zip(places, found, strict=True)] == [
            True
        ] * 40
        assert (drawn_grasps.drawn(rows, seed=3, number=40) == found).all()
        assert not (drawn_grasps.drawn(rows, seed=4, number=40) == found).all()

    def test_drawn_grasps_are_judged_in_bullet_and_by_trials(self, run: RunFolder) -> None:
        found = drawn_grasps.drawn_figures(run.path)
        assert found["drawn"] == rows_of(run.path)[0].robust_cells
        assert 0.5 < found["drawn_in_bullet"] <= 1
        assert 0.3 < found["drawn_eta"] <= 1
        assert found == drawn_grasps.drawn_figures(run.path)

    def test_a_run_in_which_nothing_holds_has_no_share(self, tmp_path: Path) -> None:
        rows = ROWS.copy()
        rows["outcome"] = np.minimum(rows["outcome"], Outcome.SHAKEN)
        record(tmp_path / "run", rows, protocol="physical", engine="mujoco")
        figures = drawn_grasps.drawn_figures(tmp_path / "run")
        assert figures == {"drawn": 0, "drawn_in_bullet": None, "drawn_eta": None}

    def test_judging_fills_the_rows_that_lack_it_and_keeps_the_others(self, run, tmp_path, monkeypatch):
        one = Wanted("run", run.spec)
        (before,) = rows_of(run.path)
        store = Store(tmp_path / "runs.csv", Programme({"grasp-bench-1": (one,)}), {before.code})
        store.add([run.path])
        work.evaluate_drawn(store, store.known, run.path, 1, Stop())
        (after,) = store.table.values()
        assert after.drawn == before.robust_cells
        assert replace(after, drawn=None, drawn_in_bullet=None, drawn_eta=None) == before
        monkeypatch.setattr(work, "drawn_figures", lambda path: pytest.fail(str(path)))
        work.evaluate_drawn(store, store.known, run.path, 1, Stop())

    def test_only_rows_of_todays_code_whose_runs_are_here_are_judged(self, run, tmp_path, monkeypatch):
        def fail(path: Path) -> None:
            raise InputError(f"{path} is gone")

        monkeypatch.setattr(work, "drawn_figures", fail)
        one = Wanted("run", run.spec)
        known = Programme({"grasp-bench-1": (one,)})
        store = Store(tmp_path / "runs.csv", known, {rows_of(run.path)[0].code})
        store.add([run.path])
        assert work.evaluate_drawn(store, known, tmp_path / "none", 1, Stop()) == {}
        assert work.evaluate_drawn(Store(store.file, known, {"other"}), known, run.path, 1, Stop()) == {}
        assert work.evaluate_drawn(store, Programme({"methods": (one,)}), run.path, 1, Stop()) == {}
        failures = work.evaluate_drawn(store, known, run.path, 1, Stop())
        assert [str(error) for error in failures.values()] == [f"{run.path} is gone"]


class TestStore:
    def store(self, path: Path, *current: str) -> Store:
        spec = RunSpec(
            gripper="panda", object="tennis_ball", method="me_rand", population=10, overlaps="count"
        )
        return Store(path / "results" / "runs.csv", Programme({"some": (Wanted("a", spec),)}), set(current))

    def test_the_page_is_written_with_the_table_and_adding_twice_changes_nothing(self, tmp_path) -> None:
        record(tmp_path / "run")
        store = self.store(tmp_path, TODAY)
        assert store.add([tmp_path / "run"]).new == 1
        before = store.file.read_bytes()
        assert store.add([tmp_path / "run"]).new == 0
        assert store.file.read_bytes() == before
        assert "0 of the 1 runs" in (store.file.parent / "index.md").read_text()

    def test_a_run_of_older_code_is_left_out_and_said_so(self, tmp_path) -> None:
        record(tmp_path / "new")
        record(tmp_path / "old", ROWS[::-1].copy(), {"code": BEFORE * 4})
        store = self.store(tmp_path, TODAY)
        store.add([tmp_path / "new"])
        found = store.add([tmp_path / "old"])
        assert (found.new, found.kept) == (0, 1)
        assert "1 of other code were left out" in found.words


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
        from qdgrasp_coordinator.search.registry import PAPER

        methods = {one.method for one in known.wanted if (one.gripper, one.budget) == ("panda", 5000)}
        assert {method.name for method in PAPER} < methods

    def test_every_comparison_has_the_default_on_the_same_scene_with_as_many_evaluations(self, known) -> None:
        default = RunSpec(gripper="any", object="any").method
        campaigns = known.campaigns.items()
        among_others = (CLAIMS, SIGMA_GRID, "grasp-bench-1-sweep")  # the paper's methods, and their settings
        compared = [one.key for name, runs in campaigns for one in runs if not name.startswith(among_others)]
        places = {(one[:3], one.seed, one.budget) for one in compared if one.method == default}
        assert {(one[:3], one.seed, one.budget) for one in compared} <= places

    def test_one_spec_has_one_name(self, known) -> None:
        names: dict[str, Key] = {}
        for one in known.wanted.values():
            assert names.setdefault(one.name, one.key._replace(budget=0)) == one.key._replace(budget=0)

    def test_a_campaign_of_full_specs_has_the_same_names(self, known) -> None:
        runs = {one.name: one.spec for one in known.wanted.values()}
        source = work.campaign_source(runs.values())
        assert list(make_campaign(source, "all.toml", here=False).runs) == list(runs)

    def test_a_folder_without_campaigns_is_no_programme(self, tmp_path) -> None:
        with pytest.raises(InputError, match="holds no campaigns"):
            programme(tmp_path)

    def test_an_unknown_campaign_is_told_of(self, known) -> None:
        with pytest.raises(InputError, match=r"No campaign 'log' in the programme; known: .*long"):
            chosen(known, ["log"])

    def test_a_text_chooses_the_runs_that_have_it_in_their_name(self, known) -> None:
        found = chosen(known, ["grasp-bench-1"], ["panda-ycb_bowl", "xarm-ycb_mug-aimed"])
        scenes = [one[:2] for one in found.wanted]
        assert {scene: scenes.count(scene) for scene in scenes} == {
            ("panda", "ycb_bowl"): 25, ("xarm", "ycb_mug"): 5
        }  # fmt: skip

    def test_a_text_that_no_run_has_in_its_name_is_told_with_how_they_are_called(self, known) -> None:
        with pytest.raises(
            InputError, match=r"No run has 'bowls' in its name; they are called as 'ref_panda_2f-"
        ):
            chosen(known, ["long"], ["bowls"])


class TestMissing:
    whole = Programme({"one": (wanted(0), wanted(1)), "two": (wanted(1), wanted(1, evaluations=500))})

    def test_a_run_is_wanted_once_however_many_ask(self) -> None:
        assert len(self.whole.wanted) == 3

    def test_what_has_no_row_of_todays_code_or_an_accepted_one_is_missing(self) -> None:
        rows = table(row(seed=0, code=BEFORE), row(seed=1))
        assert [one.key for one in self.whole.missing(rows, {TODAY})] == [
            wanted(0).key, wanted(1, evaluations=500).key,
        ]  # fmt: skip
        assert [one.key for one in self.whole.missing(rows, {TODAY, BEFORE})] == [
            wanted(1, evaluations=500).key
        ]

    def test_a_long_run_knows_of_which_shorter_ones_it_has_the_rows(self) -> None:
        assert self.whole.budgets(wanted(1, evaluations=9000).key) == {1000, 500}
        assert self.whole.budgets(wanted(2).key) == set()


class TestOrder:
    def test_of_a_scene_what_is_cheaper_comes_first(self) -> None:
        runs = [wanted(0, evaluations=3000), wanted(1), wanted(0, gripper="barrett"), wanted(0)]
        keys = [one.key for one in ordered(runs, Costs([]))]
        assert keys == [runs[3].key, runs[1].key, runs[0].key, runs[2].key]

    def test_scenes_are_done_one_after_the_other_the_cheapest_first(self) -> None:
        costs = Costs([row("aimed", cpu_seconds=9.0), row("me_scs", cpu_seconds=1.0)])
        few, many = (
            [wanted(seed, object=name, overlaps="count", method=method) for method in ("me_scs", "aimed")
             for seed in range(seeds)]
            for name, seeds in (("ycb_mug", 2), ("ycb_bowl", 3))
        )  # fmt: skip
        assert [one.key for one in ordered(many + few, costs)] == [one.key for one in few + many]

    def test_costs_are_those_of_the_runs_most_alike(self) -> None:
        costs = Costs([row(cpu_seconds=7.0), row(cpu_seconds=9.0), row("me_scs", cpu_seconds=2.0)])
        asked = row(seed=5).key
        assert costs.seconds(asked) == 8.0
        assert costs.seconds(asked._replace(budget=500)) == 4.0
        assert costs.seconds(asked._replace(object="ycb_bowl")) == 8.0
        assert costs.seconds(asked._replace(method="cma_mae")) == 7.0

    def test_another_engine_or_protocol_costs_otherwise(self) -> None:
        costs = Costs([row(cpu_seconds=7.0), row(protocol="physical in mujoco", cpu_seconds=40.0)])
        assert costs.seconds(row().key) == 7.0
        assert costs.seconds(row(protocol="physical in mujoco").key) == 40.0
        assert costs.seconds(row(protocol="physical").key) == Costs([]).seconds(row().key)

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


TEAM = LocalJobConfig(workers=1)


def wanted_runs(seed: int, evaluations: int = 1000) -> Wanted:
    spec = RunSpec(gripper="panda", object="mug", method="me_rand", seed=seed, evaluations=evaluations)
    return Wanted(f"panda-mug-me_rand-s{seed}", spec)


class TestGrowing:
    def budgets(self, place: Path, *stage: Wanted) -> list[tuple[str, int]]:
        asked = work.extended_campaign(place, stage)
        begin_campaign(place, asked)
        return [(name, spec.evaluations) for name, spec in asked.runs.items()]

    def test_a_later_stage_keeps_what_was_begun_with_the_programmes_names_and_extends_it(self, tmp_path):
        place = tmp_path / "a"
        self.budgets(place, wanted_runs(0), wanted_runs(1))
        assert self.budgets(place, wanted_runs(2), wanted_runs(1, 5000)) == [
            (wanted_runs(0).name, 1000), (wanted_runs(1).name, 5000), (wanted_runs(2).name, 1000),
        ]  # fmt: skip

    def test_a_run_never_gets_a_smaller_budget(self, tmp_path) -> None:
        place = tmp_path / "a"
        self.budgets(place, wanted_runs(0, 5000))
        assert self.budgets(place, wanted_runs(0)) == [(wanted_runs(0).name, 5000)]


class TestCarryingOn:
    known = Programme({"some": (*(wanted_runs(seed) for seed in range(3)), wanted_runs(0, 2000))})

    @pytest.fixture
    def store(self, tmp_path, monkeypatch) -> Store:
        monkeypatch.setattr(work, "code_folder", lambda runs: runs / "here")
        return Store(tmp_path / "runs.csv", self.known, {TODAY})

    def test_each_run_is_tried_once_and_a_failure_stops_no_other(self, store, tmp_path, monkeypatch) -> None:
        tried: list[Wanted] = []

        def fail(_place: Path, stage: list[Wanted], *_: object) -> None:
            tried.extend(stage)
            raise InputError("no such mesh")

        monkeypatch.setattr(work, "run_stage", fail)
        failures = work.run_missing(store, self.known, tmp_path, TEAM, Stop())
        assert sorted(one.key for one in tried) == sorted(self.known.wanted)
        assert len(failures) == len(list(stages(tried, Costs([]))))

    def test_what_is_not_on_this_machine_is_told_of_and_left_out(self, store, tmp_path, monkeypatch) -> None:
        tried: list[Wanted] = []
        monkeypatch.setattr(work, "run_stage", lambda _place, stage, *_: tried.extend(stage))
        absent = Wanted("absent", RunSpec(gripper="claw", object="mug"))
        both = Programme({"some": (wanted_runs(0), absent)})
        failures = work.run_missing(Store(store.file, both, {TODAY}), both, tmp_path, TEAM, Stop())
        assert [str(error)[:22] for error in failures] == ["Unknown gripper 'claw'"]
        assert tried == [wanted_runs(0)]

    def test_what_the_benchmark_makes_is_made_once_it_is_asked_for(self, store, tmp_path, monkeypatch):
        tried: list[Wanted] = []
        monkeypatch.setattr(work, "run_stage", lambda _place, stage, *_: tried.extend(stage))
        asked = Wanted("panda-plate-s0", RunSpec(gripper="panda", object=f"{NAME}/plate.stl", mass=0.065))
        one = Programme({"some": (asked,)})
        assert work.run_missing(Store(store.file, one, {TODAY}), one, tmp_path, TEAM, Stop()) == []
        assert [(run.key, run.spec.object) for run in tried] == [
            (asked.key, str(tmp_path / NAME / "plate.stl"))
        ]
        assert [path.name for path in (tmp_path / NAME).iterdir()] == ["plate.stl"]

    def test_a_signal_ends_it_after_the_stage(self, store, tmp_path, monkeypatch) -> None:
        stop, stages_done = Stop(), []

        def stopped(*_: object) -> None:
            stages_done.append(1)
            stop.set(signal.SIGINT)

        monkeypatch.setattr(work, "run_stage", stopped)
        assert work.run_missing(store, self.known, tmp_path, TEAM, stop) == []
        assert len(stages_done) == 1


def test_the_place_of_runs_depends_on_what_evaluates_and_on_what_searches(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(work, "platform", lambda: {"code": "a"})
    before = work.code_folder(tmp_path)
    assert work.code_folder(tmp_path) == before
    monkeypatch.setattr(work, "platform", lambda: {"code": "b"})
    assert work.code_folder(tmp_path) != before
    monkeypatch.setattr(work, "platform", lambda: {"code": "a"})
    monkeypatch.setattr(work, "_search_digest", lambda: b"another")
    assert work.code_folder(tmp_path) != before
