"""Constants of the default search that are replaced, refitted, and compared with today's."""

import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from benchmarks import single_run
from benchmarks.leave_one_out import __main__ as program
from benchmarks.leave_one_out import runs
from benchmarks.leave_one_out.grid import GRID, TODAY, VARIANTS, holders, patched, values_of, variant
from benchmarks.leave_one_out.page import page
from benchmarks.leave_one_out.refit import compare, refits, robust_cells, scores, standard_error
from benchmarks.leave_one_out.runs import (
    COLUMNS,
    EVALUATIONS,
    TUNING_SEEDS,
    Key,
    Row,
    held_out_runs,
    read,
    run_missing,
    tuning_runs,
)
from benchmarks.results.programme import TUNING
from tests.coordinator.search.synthetic_scene import shape
from tests.coordinator.search.test_aimed import build, spec

from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.aimed import CONTACT, TARGET
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome

HOMES = [home for one in GRID.values() for home in one.homes]


def value_at(home: str) -> float:
    module, _, name = home.rpartition(".")
    value: float = getattr(import_module(module), name)
    return value


class TestGrid:
    def test_todays_values_are_those_of_the_code(self) -> None:
        assert [value_at(home) for home in HOMES] == [one.today for one in GRID.values() for _ in one.homes]

    def test_a_variants_name_says_its_values(self) -> None:
        assert len(set(VARIANTS)) == 1 + 2 * len(GRID)
        values = {"WANTED": 0.3, "POINT_SIGMA": 0.0035, "DEAD_END": 0.5}
        assert variant(values) == "WANTED=0.3 POINT_SIGMA=0.0035"
        assert values_of(variant(values)) == {"WANTED": 0.3, "POINT_SIGMA": 0.0035}
        assert variant(values_of(TODAY)) == TODAY

    def test_a_value_that_is_not_in_the_grid_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"'WANTED=0.31' of the variant 'DEAD_END=1 WANTED=0.31' is not"):
            values_of("DEAD_END=1 WANTED=0.31")

    def test_a_constant_is_replaced_wherever_it_was_imported_and_put_back(self) -> None:
        places = {found.__name__ for found in holders("qdgrasp_assets.genes.TOUCH_VALUE")}
        assert places >= {"qdgrasp_worker.candidate_ranking", "qdgrasp_coordinator.search.value_search"}

        def interrupted() -> None:
            with patched({"TOUCH_VALUE": 0.4}):
                assert {sys.modules[place].TOUCH_VALUE for place in places} == {0.4}
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert {sys.modules[place].TOUCH_VALUE for place in places} == {0.2}


OUTCOMES = (Outcome.DEAD_END, Outcome.MISSED, Outcome.DROPPED, Outcome.HELD)


def played(name: str) -> bytes:
    """The genomes that a variant asks in 20 generations, whose outcomes and features are drawn."""
    with patched(values_of(name)):
        search, where = build(spec(aim_for="hold"))
        asked = [search.ask(0)]
        for generation in range(20):
            rows, random = shape(where).empty(len(asked[-1])), np.random.default_rng(generation)
            aims = where.layout.values(asked[-1])
            rows["genome"], rows["outcome"] = asked[-1], random.choice(OUTCOMES, len(aims))
            rows["descriptor"] = random.random(rows["descriptor"].shape)
            rows["descriptor"][:, :3], rows["surface_point"] = aims[:, TARGET], aims[:, CONTACT]
            rows["base_to_object"][:, 6] = 1.0
            search.tell(generation, rows)
            asked.append(search.ask(generation + 1))
    return np.concatenate(asked).tobytes()


def ran(name: str) -> bytes:
    """The journal of a short run of a variant, before anything is learned."""
    asked = {"gripper": "panda", "object": "tennis_ball", "protocol": "physical", "engine": "mujoco"}
    with patched(values_of(name)):
        return single_run.run(full_spec(asked | {"evaluations": 10})).rows.tobytes()


OF_WORKERS = [name for name in VARIANTS if name.startswith(("POINT_SIGMA", "MOST_CANDIDATES"))]
"""Variants that change the evaluation of a genome by a worker."""
OF_SEARCH = [name for name in VARIANTS[1:] if name not in OF_WORKERS]


@pytest.mark.parametrize(("found", "names"), [(played, OF_SEARCH), (ran, OF_WORKERS)])
def test_each_variant_searches_in_its_own_way_and_leaves_no_trace(found, names) -> None:
    usual = found(TODAY)
    assert len({usual, *map(found, names)}) == 1 + len(names)
    assert found(TODAY) == usual


def row(asked: Key, held: float = 100, code: str = "c0de") -> Row:
    return Row(*asked, robust_cells=round(held), cells=200, cpu_seconds=1.5, code=code)


class TestTable:
    asked = tuning_runs(20)[:4]

    @pytest.fixture
    def carried(self, monkeypatch: pytest.MonkeyPatch) -> list[Key]:
        """The runs that are carried out; they cost nothing."""
        found: list[Key] = []

        def carry_out(key: Key) -> Row:
            if len(found) == 3:
                raise KeyboardInterrupt
            found.append(key)
            return row(key)

        monkeypatch.setattr(runs, "carry_out", carry_out)
        return found

    def test_a_run_that_is_in_is_not_carried_out_again(self, tmp_path: Path, carried: list[Key]) -> None:
        file = tmp_path / "table.csv"
        with pytest.raises(KeyboardInterrupt):
            run_missing(file, self.asked, {"c0de"})
        assert carried == self.asked[:3]
        assert list(read(file)) == sorted(carried)
        carried.clear()
        run_missing(file, self.asked, {"c0de"})
        assert carried == self.asked[3:]
        assert file.read_text().splitlines() == [
            ",".join(COLUMNS),
            *sorted(f"{name},ycb_rubiks_cube,1,20,100,200,1.5,c0de" for name, *_ in self.asked),
        ]

    def test_a_run_of_other_code_is_done_again_unless_that_is_accepted(self, tmp_path, carried) -> None:
        file = tmp_path / "table.csv"
        run_missing(file, self.asked[:2], {"c0de"})
        carried.clear()
        run_missing(file, self.asked[:2], {"new", "c0de"})
        assert carried == []
        run_missing(file, self.asked[:2], {"new"})
        assert carried == self.asked[:2]

    @pytest.mark.parametrize(
        ("line", "fault"),
        [
            ("today,ycb_mug,1,20,100,200,1.5,c0de,more", "line 2"),
            ("today,ycb_mug,one,20,100,200,1.5,c0de", "line 2: .*int"),
            ("WANTED=2,ycb_mug,1,20,100,200,1.5,c0de", "'WANTED=2' of the variant"),
        ],
    )
    def test_a_line_of_something_else_is_refused(self, tmp_path: Path, line: str, fault: str) -> None:
        (tmp_path / "table.csv").write_text(f"{','.join(COLUMNS)}\n{line}\n")
        with pytest.raises(InputError, match=fault):
            read(tmp_path / "table.csv")

    def test_a_run_counts_cells_that_hold_and_cells(self) -> None:
        found = runs.carry_out(Key("EXPLORING_SHARE=0.08", "tennis_ball", 1, 10))
        assert found.key == ("EXPLORING_SHARE=0.08", "tennis_ball", 1, 10)
        assert 0 < found.robust_cells <= found.cells <= 10
        assert found.code == runs.code_digest()


def tuned(gains: Mapping[str, Mapping[str, int]]) -> dict[Key, Row]:
    """All tuning runs: 980, 1000 and 1020 cells that hold, and what variants gain on objects."""
    asked = tuning_runs(EVALUATIONS)
    found = {key: 1000 + gains.get(key.variant, {}).get(key.scene, 0) + 20 * (key.seed - 2) for key in asked}
    return {key: row(key, held) for key, held in found.items()}


def on(gain: int, *scenes: str) -> dict[str, int]:
    return dict.fromkeys(scenes, gain)


class TestRefit:
    def test_the_error_follows_from_the_spread_of_seeds_within_variants(self) -> None:
        found = robust_cells(tuned({"WANTED=0.3": on(300, *TUNING)}), EVALUATIONS)
        known = {scene: scores(found, scene) for scene in TUNING}
        assert known["ycb_mug"][TODAY].tolist() == pytest.approx([980 / 1020, 1000 / 1020, 1020 / 1020])
        assert standard_error(known) == pytest.approx(np.sqrt(2 * 400 / len(TUNING_SEEDS) / 3) / 1020)

    @pytest.mark.parametrize(
        ("gain", "values", "clear"),
        [(0, {}, ()), (9, {"WANTED": 0.7}, ()), (10, {"WANTED": 0.7}, ("WANTED",)), (-90, {}, ())],
        ids=str,
    )
    def test_a_value_gives_way_to_a_better_one_which_is_clear_beyond_an_error(self, gain, values, clear):
        """The error is 9.4 cells."""
        found = refits(tuned({"WANTED=0.7": on(gain, *TUNING)}), EVALUATIONS)[""]
        assert (found.values, found.clear) == (values, clear)

    def test_of_two_better_values_the_best_one_is_taken(self) -> None:
        table = tuned({"DEAD_END=0.25": on(50, *TUNING), "DEAD_END=1": on(80, *TUNING)})
        assert refits(table, EVALUATIONS)[""].values == {"DEAD_END": 1.0}

    def test_what_one_object_decides_is_not_there_without_it(self) -> None:
        known = refits(tuned({"EXPLORING_SHARE=0.08": on(300, "ycb_mug")}), EVALUATIONS)
        assert {left_out: one.variant for left_out, one in known.items()} == {
            "": "EXPLORING_SHARE=0.08",
            "ycb_rubiks_cube": "EXPLORING_SHARE=0.08",
            "ycb_mug": TODAY,
            "ycb_power_drill": "EXPLORING_SHARE=0.08",
        }

    def test_nothing_is_refitted_before_all_runs_are_in(self) -> None:
        table = tuned({})
        assert set(refits(table, EVALUATIONS)) == {"", *TUNING}
        table.popitem()
        assert refits(table, EVALUATIONS) == {}


def held_out(name: str, gain: int) -> dict[Key, Row]:
    """All held-out runs: of today's constants 980 to 1020 cells that hold, of others so many more."""
    asked = held_out_runs([name], EVALUATIONS)
    return {key: row(key, 1000 + 10 * (key.seed - 3) + gain * (key.variant != TODAY)) for key in asked}


class TestComparison:
    @pytest.mark.parametrize(("gain", "is_within"), [(1, True), (-1, True), (50, False), (-50, False)])
    def test_a_difference_is_less_where_it_lies_in_the_interval_of_todays_mean(self, gain, is_within) -> None:
        compared = compare(robust_cells(held_out("WANTED=0.3", gain), EVALUATIONS), "WANTED=0.3")
        assert compared.difference.value == pytest.approx(gain / 1000)
        assert compared.difference.low < gain / 1000 < compared.difference.high
        assert 0.98 < compared.today.low < 1.0 < compared.today.high < 1.02
        assert compared.is_within is is_within
        assert compared.is_equivalent is is_within


def lines(text: str, first: str) -> list[str]:
    """The lines of tables that begin with a cell."""
    return [line for line in text.splitlines() if line.startswith(f"| {first} |")]


GAINS = {"EXPLORING_SHARE=0.08": on(300, "ycb_mug")}


class TestPage:
    def test_of_nothing_it_says_that_all_is_missing(self) -> None:
        text = page({}, EVALUATIONS)
        assert lines(text, "tuning") == ["| tuning | 135 | 0 |"]
        assert "Not all tuning runs are in." in text

    def test_of_a_part_it_has_the_scores_of_objects_with_all_variants(self) -> None:
        table = {key: one for key, one in tuned({}).items() if key.seed == 1 and key.scene != "ycb_mug"}
        table.pop(Key("WANTED=0.3", "ycb_power_drill", 1, EVALUATIONS))
        text = page(table, EVALUATIONS)
        assert lines(text, "tuning") == ["| tuning | 135 | 29 |"]
        assert lines(text, "`today`") == ["| `today` | 980 (1.000) |  | 980 |  |"]
        assert lines(text, "`WANTED=0.3`") == ["| `WANTED=0.3` | 980 (1.000) |  |  |  |"]

    def test_of_all_runs_it_has_refitted_constants_and_verdicts(self) -> None:
        text = page(tuned(GAINS) | held_out("EXPLORING_SHARE=0.08", 50), EVALUATIONS)
        assert lines(text, "held out") == ["| held out | 60 | 60 |"]
        assert "**0.08**" in lines(text, "all three")[0]
        assert "**" not in lines(text, "all but ycb_mug")[0]
        assert lines(text, "all three")[1].startswith("| all three | `EXPLORING_SHARE=0.08` | +5.0 | +")
        assert lines(text, "all three")[1].endswith("| **not less** | **not shown** |")
        assert lines(text, "all but ycb_mug")[1].endswith("| less: the same constants | yes |")
        assert lines(text, "ycb_bowl") == ["| ycb_bowl | 1000 ± 16 | 1050 ± 16 |"]

    def test_a_comparison_waits_for_all_its_runs(self) -> None:
        there = held_out("EXPLORING_SHARE=0.08", 1)
        there.popitem()
        text = page(tuned(GAINS) | there, EVALUATIONS)
        assert lines(text, "all three")[1].endswith("| not all runs are in |  |")

    def test_runs_of_another_budget_are_not_on_it(self) -> None:
        other = Key(TODAY, "ycb_mug", 1, 20)
        assert page({other: row(other)}, EVALUATIONS) == page({}, EVALUATIONS)

    def test_the_page_that_lies_beside_the_table_is_the_one_it_makes(self) -> None:
        whole = read(program.RESULTS / program.TABLE)
        assert (program.RESULTS / program.PAGE).read_text(encoding="utf-8") == page(whole, EVALUATIONS)


def test_the_program_carries_out_what_is_chosen_and_makes_the_page(tmp_path, monkeypatch) -> None:
    found: list[Key] = []
    monkeypatch.setattr(runs, "carry_out", lambda key: found.append(key) or row(key))
    words = ["--out", str(tmp_path), "--scenes", "ycb_mug", "ycb_bowl", "--seeds", "2", "--processes", "1"]
    monkeypatch.setattr("sys.argv", ["-", *words])
    program.main()
    asked = [(name, "ycb_mug", 2, EVALUATIONS) for name in VARIANTS]
    assert found == [*asked, (TODAY, "ycb_bowl", 2, EVALUATIONS)]
    assert (tmp_path / program.PAGE).read_text() == page({key: row(key) for key in found}, EVALUATIONS)
    monkeypatch.setattr("sys.argv", ["-", *words, "--page"])
    (tmp_path / program.TABLE).unlink()
    program.main()
    assert (tmp_path / program.PAGE).read_text() == page({}, EVALUATIONS)


def test_a_program_that_is_stopped_says_so_and_has_made_the_page(tmp_path, monkeypatch, capsys) -> None:
    def stop(_: Key) -> Row:
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "carry_out", stop)
    monkeypatch.setattr("sys.argv", ["-", "--out", str(tmp_path), "--processes", "1"])
    with pytest.raises(SystemExit) as ended:
        program.main()
    assert ended.value.code == 130
    assert "Stopped" in capsys.readouterr().err
    assert (tmp_path / program.PAGE).exists()


def test_a_damaged_table_ends_the_program_with_a_sentence(tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / program.TABLE).write_text("something,else\n1,2\n")
    monkeypatch.setattr("sys.argv", ["-", "--out", str(tmp_path), "--page"])
    with pytest.raises(SystemExit) as ended:
        program.main()
    assert ended.value.code == 2
    assert "line 2" in capsys.readouterr().err
