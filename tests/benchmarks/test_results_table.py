"""The table of results and its page."""

import random
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from benchmarks.results import table
from benchmarks.results import table as tables
from benchmarks.results.assets import NAME, OBJECTS
from benchmarks.results.benchmark import BEST_OTHER, benchmark_part, draw
from benchmarks.results.comparison import Arm, MethodComparison, arms, comparison_part, holm
from benchmarks.results.page import coverage_part, cpu_part, page
from benchmarks.results.programme import Programme, Wanted, programme
from benchmarks.results.reference_sets import FOLDER, read
from benchmarks.results.table import COLUMNS, Row, key
from msgspec import structs

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec

TODAY, BEFORE = "c0de" * 4, "01dc0de0" * 2


def row(method: str = "aimed", seed: int = 0, **values: Any) -> Row:
    """A finished run of 1000 evaluations."""
    said: dict[str, Any] = {
        "gripper": "panda", "object": "ycb_mug", "protocol": "paper", "overlaps": "count", "settings": "",
        "budget": 1000, "version": "0.1.0", "code": TODAY, "platform": "aa", "scene": "bb", "journal": "cc",
        "evaluations": 1000, "simulated": 500, "proposals": 1000, "successes": 100, "grasps": 80,
        "robust": 60, "cells": 90, "cpu_seconds": 10.0,
    }  # fmt: skip
    return Row(**{**said, "method": method, "seed": seed, **values})


ROWS = [row(seed=seed, method=method) for method in ("aimed", "me_scs") for seed in (0, 1, 10)]


def written(*rows: Row) -> str:
    return table.text(table.merged({}, rows, {TODAY}))


class TestIdentity:
    def test_a_spec_and_the_row_of_its_run_have_one_key(self) -> None:
        spec = RunSpec(gripper="panda", object="ycb_mug", method="me_scs", evaluations=1000, overlaps="count")
        assert key(spec) == row("me_scs").key

    @pytest.mark.parametrize(
        "other",
        [{"seed": 1}, {"protocol": "released"}, {"evaluations": 999}, {"population": 60}, {"mass": 0.2}],
    )
    def test_whatever_a_spec_says_is_in_its_key(self, other: dict[str, object]) -> None:
        spec = {"gripper": "panda", "object": "ycb_mug"}
        assert key(RunSpec(**spec)) != key(RunSpec(**spec, **other))  # type: ignore[arg-type]

    def test_what_has_no_column_is_told_where_it_is_not_the_specs_default(self) -> None:
        assert key(RunSpec(gripper="panda", object="mug", population=50)).settings == "population=50"

    def test_an_engine_is_said_with_the_protocol(self) -> None:
        found = key(RunSpec(gripper="panda", object="mug", protocol="physical", engine="mujoco"))
        assert (found.protocol, found.settings) == ("physical in mujoco", "")
        assert found.words.endswith("(physical in mujoco, every pose counted)")

    def test_runs_whose_surface_seed_is_their_seed_differ_in_their_seed_alone(self) -> None:
        spec = {"gripper": "panda", "object": "mug"}
        keys = [key(RunSpec(**spec, seed=seed, surface_seed=seed)) for seed in (1, 2)]
        assert keys[0].settings == "surface_seed=seed"
        assert keys[0] == keys[1]._replace(seed=1)
        assert key(RunSpec(**spec, seed=1, surface_seed=2)).settings == "surface_seed=2"
        assert key(RunSpec(**spec)).settings == ""

    def test_what_the_benchmark_makes_is_named_by_its_stem_wherever_it_lies(self) -> None:
        here = RunSpec(gripper=f"{NAME}/xarm.toml", object=f"{NAME}/vase.stl", mass=OBJECTS["vase"].mass)
        there = structs.replace(here, gripper=f"/data/{NAME}/xarm.toml", object=f"/data/{NAME}/vase.stl")
        assert key(here) == key(there)
        assert (key(here).gripper, key(here).object, key(here).settings) == ("xarm", "vase", "")
        assert key(structs.replace(here, mass=1.0)).settings == "mass=1.0"

    @pytest.mark.parametrize("file", ["/home/me/mine.stl", "mine.stl", "here/mine", f"{NAME}/mine.stl"])
    def test_a_run_on_a_file_has_no_row(self, file: str) -> None:
        with pytest.raises(InputError, match="is a file of this machine"):
            key(RunSpec(gripper="panda", object=file))


class TestText:
    def test_no_file_is_an_empty_table_and_a_table_comes_back_as_it_was(self, tmp_path) -> None:
        whole = table.merged({}, [*ROWS, row(object="mug", coverage=0.12345, set_size=7060)], {TODAY})
        assert table.read(tmp_path / "runs.csv") == {}
        table.write(tmp_path / "runs.csv", whole)
        assert table.read(tmp_path / "runs.csv") == whole

    def test_as_parquet_it_has_the_same_columns_and_rows(self, tmp_path) -> None:
        whole = table.merged({}, [*ROWS, row(object="mug", coverage=0.12345, set_size=7060)], {TODAY})
        (tmp_path / "runs.parquet").write_bytes(table.parquet(whole))
        read = pandas.read_parquet(tmp_path / "runs.parquet")
        assert tuple(read.columns) == COLUMNS
        assert read["coverage"].dropna().tolist() == [0.12345]
        assert read["seed"].tolist() == [one.seed for one in whole.values()]

    def test_the_order_in_which_rows_came_changes_nothing(self) -> None:
        shuffled = random.Random(0).sample(ROWS, len(ROWS))  # noqa: S311 - no secret
        assert written(*shuffled) == written(*ROWS)

    def test_seeds_are_in_the_order_of_numbers(self) -> None:
        lines = written(*ROWS).splitlines()[1:]
        assert [line.split(",")[COLUMNS.index("seed")] for line in lines] == ["0", "1", "10"] * 2

    def test_a_run_more_is_one_line_more(self) -> None:
        before, after = written(*ROWS[:-1]).splitlines(), written(*ROWS).splitlines()
        assert len(after) == len(before) + 1
        assert [line for line in after if line in before] == before

    def test_an_older_table_may_lack_a_figure(self, tmp_path) -> None:
        file, column = tmp_path / "runs.csv", COLUMNS.index("niches")
        lines = [line.split(",") for line in written(*ROWS).splitlines()]
        file.write_text("\n".join(",".join(line[:column] + line[column + 1 :]) for line in lines) + "\n")
        assert list(table.read(file).values()) == sorted(ROWS, key=lambda one: one.key)


class TestBadText:
    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("gripper,", "gripers,", "line 1: unknown column 'gripers'"),
            ("gripper,", "", "line 1: column 'gripper' is missing"),
            (",1000,0.1.0", ",many,0.1.0", r"line 2: .*int.*budget"),
            (",0.1.0", "", f"line 2: expected {len(COLUMNS)} fields"),
            ("aimed,count,,1", "aimed,count,,0", "line 3: aimed with panda on ycb_mug, seed 0"),
        ],
    )
    def test_it_is_refused_in_one_sentence_with_its_line(self, tmp_path, old, new, said) -> None:
        file = tmp_path / "runs.csv"
        file.write_text(written(*ROWS).replace(old, new, 1))
        with pytest.raises(InputError, match=said) as error:
            table.read(file)
        assert str(file) in str(error.value)
        assert "\n" not in str(error.value)

    def test_what_is_no_text_is_no_table(self, tmp_path) -> None:
        (tmp_path / "runs.csv").write_bytes(b"\xff\xfe")
        with pytest.raises(InputError, match="no table of results"):
            table.read(tmp_path / "runs.csv")


class TestMerging:
    def test_a_row_of_todays_code_takes_the_place_of_an_older_one(self) -> None:
        old, new = row(code=BEFORE, cells=1), row(cells=2)
        assert list(table.merged({old.key: old}, [new], {TODAY}).values()) == [new]

    def test_a_row_of_older_code_stays_until_then(self) -> None:
        old = row(code=BEFORE)
        assert old in table.merged({old.key: old}, ROWS[1:], {TODAY}).values()

    def test_an_older_row_takes_no_place_of_a_row_of_today(self) -> None:
        new = row()
        assert list(table.merged({new.key: new}, [row(code=BEFORE)], {TODAY}).values()) == [new]

    def test_figures_of_drawn_grasps_stay_with_their_journal(self) -> None:
        judged = row(drawn=30, drawn_in_bullet=0.9, drawn_eta=0.8)
        for found, number in ((row(wall_seconds=7.0), 30), (row(journal="another"), None)):
            (merged,) = table.merged({judged.key: judged}, [found], {TODAY}).values()
            assert (merged.drawn, merged.wall_seconds) == (number, found.wall_seconds)

    def test_a_run_done_again_takes_its_own_place(self) -> None:
        before, again = row(cells=1), row(cells=2)
        assert list(table.merged({before.key: before}, [again], {TODAY}).values()) == [again]


RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
CUBE = {"gripper": "ref_panda_2f", "object": "ycb_rubiks_cube", "protocol": "released", "overlaps": "redraw"}


def made_row(method: str = "aimed", seed: int = 0, **values: Any) -> Row:
    """A finished run of the default method or another, with that method's own settings."""
    settings = "population=50" if method == "aimed" else ""
    return row(method, seed, **{"settings": settings, **values})


def of(*rows: Row, absent: tuple[Row, ...] = ()) -> tuple[Programme, dict]:
    """A programme of these runs, and a table of the first ones."""
    runs = tuple(Wanted("run", _spec(one)) for one in (*rows, *absent))
    return Programme({"some": runs}), {one.key: one for one in rows}


def _spec(one: Row) -> RunSpec:
    named = {
        name: getattr(one, name) for name in ("gripper", "object", "protocol", "method", "overlaps", "seed")
    }
    settings = {"population": int(one.settings.removeprefix("population="))} if one.settings else {}
    return RunSpec(**named, **settings, evaluations=one.budget)


def cells(text: str, first: str) -> list[str]:
    """The cells of the line of a table that begins with `first`."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_page_that_lies_beside_the_table_is_the_one_it_makes() -> None:
    whole = tables.read(RESULTS / "runs.csv")
    assert (RESULTS / "index.md").read_text(encoding="utf-8") == page(
        programme(), whole, read(RESULTS / FOLDER)
    )


def test_a_page_of_nothing_says_that_everything_is_missing() -> None:
    known, _ = of(made_row(), made_row("me_scs"))
    text = page(known, {})
    assert "0 of the 2 runs of the programme are in" in text
    assert "1 of 1 comparisons are not in yet" in text


def test_a_row_that_nobody_asks_for_is_counted_apart() -> None:
    known, whole = of(made_row())
    other = made_row("me_scs")
    assert "1 more rows of the table are of runs that it does not ask for" in page(
        known, whole | {other.key: other}
    )


class TestCoverage:
    found = tuple(
        made_row(seed=seed, budget=10_000, coverage_5k=0.6, coverage_10k=end, coverage=end, **CUBE)
        for seed, end in enumerate((0.84, 0.86, 0.80))
    )

    def text(self, *rows: Row, absent: tuple[Row, ...] = ()) -> str:
        return coverage_part(arms(*of(*rows, absent=absent)))

    def test_it_has_median_range_and_by_how_much_the_aim_is_missed(self) -> None:
        line = cells(self.text(*self.found), "ref_panda_2f")
        assert "84.0 (80.0 to 86.0)" in line
        assert line[-2] == "50 at 5,000: met, 85 at 10,000: **short**"
        assert "1.0 points short of 85 % at 10,000" in self.text(*self.found)

    def test_runs_that_are_not_in_are_counted(self) -> None:
        text = self.text(*self.found[:1], absent=self.found[1:])
        assert "1 of 3" in cells(text, "ref_panda_2f")
        assert "2 of the 3 runs are not in yet" in text

    def test_without_a_run_no_aim_is_met_or_missed(self) -> None:
        text = self.text(absent=self.found)
        assert cells(text, "ref_panda_2f")[-2] == "50 at 5,000, 85 at 10,000"
        assert "short" not in text


def compared(*rows: Row) -> str:
    return comparison_part(arms(*of(*rows)))


FIVE = range(5)


class TestComparisons:
    def text(self, ours: Sequence[float], theirs: Sequence[float]) -> str:
        rows = [made_row(seed=seed, coverage=value, robust_share=0.3) for seed, value in enumerate(ours)]
        others = ((seed, {"coverage": value, "robust_share": 0.4}) for seed, value in enumerate(theirs))
        return compared(*rows, *(made_row("me_scs", seed, **figures) for seed, figures in others))

    def test_differences_are_of_means_and_runs_are_not_paired(self) -> None:
        line = cells(self.text([0.2, 0.3, 0.25, 0.2, 0.3], [0.1, 0.2, 0.15, 0.1, 0.2, 0.15]), "panda")
        assert line[3] == "5 / 6"
        assert line[5:8] == ["25.0 (20.0 to 30.0)", "15.0 (10.0 to 20.0)", "+10.0"]
        assert line[10] == "win"

    def test_an_interval_around_zero_is_nobodys_win(self) -> None:
        text = self.text([0.2, 0.3, 0.2, 0.1, 0.2], [0.1, 0.3, 0.2, 0.2, 0.2])
        assert cells(text, "panda")[10] == "undecided"

    def test_four_seeds_prove_nothing(self) -> None:
        line = cells(self.text([0.2, 0.21, 0.22, 0.2], [0.1] * 5), "panda")
        assert line[8:11] == ["", "", "few seeds"]

    def test_of_many_comparisons_fewer_are_won(self) -> None:
        ours, theirs = (0.50, 0.60, 0.55, 0.58, 0.53), (0.45, 0.54, 0.42, 0.47, 0.48)
        alone = self.text(ours, theirs)
        assert cells(alone, "panda")[10] == "win"
        others = [
            made_row(method, seed, object=f"ycb_{name}", coverage=0.3 + 0.1 * (seed % 2))
            for method in ("aimed", "me_scs")
            for name in ("bowl", "banana", "spatula", "chips_can", "tennis_ball")
            for seed in FIVE
        ]
        rows = [made_row(seed=seed, coverage=value) for seed, value in enumerate(ours)]
        rivals = [made_row("me_scs", seed, coverage=value) for seed, value in enumerate(theirs)]
        lines = [line for line in compared(*rows, *rivals, *others).splitlines() if "| ycb_mug |" in line]
        assert "| undecided |" in lines[0]

    def test_losses_are_listed_in_every_figure(self) -> None:
        text = self.text([0.1] * 5, [0.2] * 5)
        assert "losses 1. Behind nowhere in: mean best fitness; orientations; niches." in text
        assert "| the figure that decides | panda | ycb_mug | `me_scs` 10.0 |  |" in text
        assert "| robust share of S_G | panda | ycb_mug | `me_scs` 10.0 |  |" in text

    def test_who_is_ahead_but_not_for_certain_stands_apart(self) -> None:
        text = self.text([0.2, 0.3, 0.2, 0.1, 0.2], [0.1, 0.3, 0.4, 0.3, 0.2])
        assert "| the figure that decides | panda | ycb_mug |  | `me_scs` 6.0 |" in text

    @pytest.mark.parametrize(("protocol", "figure"), [("paper", "cells"), ("physical", "cells that hold")])
    def test_without_a_set_cells_are_compared_and_under_physical_those_that_hold(self, protocol, figure):
        column = {"cells": "cells", "cells that hold": "robust_cells"}[figure]
        rows = [
            made_row(method, seed, protocol=protocol, **{"cells": 7, column: count})
            for method, count in {"aimed": 100, "me_scs": 60}.items()
            for seed in FIVE
        ]
        found = cells(compared(*rows), "panda")[4:8]
        assert found == [figure, "100 (100 to 100)", "60 (60 to 60)", "+40"]

    def test_several_objects_are_also_taken_together(self) -> None:
        rows = [
            made_row(method, seed, object=name, coverage=value)
            for method, value in (("aimed", 0.3), ("me_scs", 0.1))
            for name in ("ycb_mug", "ycb_bowl")
            for seed in FIVE
        ]
        text = compared(*rows)
        assert "| panda | `me_scs` | 2 | coverage, % | +20.0 | +20.0 to +20.0 | ≤ 0.0002 | win |" in text

    def test_runs_of_another_counting_are_not_compared(self) -> None:
        ours = made_row(coverage=0.2), made_row(coverage=0.5, overlaps="redraw")
        text = compared(*ours, made_row("me_scs", coverage=0.1))
        assert re.findall("^### .*", text, re.MULTILINE) == ["### 1,000 evaluations, every pose counted"]
        assert len([line for line in text.splitlines() if line.startswith("| panda")]) == 1

    def test_two_evaluation_codes_are_marked_and_one_is_not(self) -> None:
        text = compared(made_row(coverage=0.2), made_row("me_scs", coverage=0.1, code=BEFORE))
        assert cells(text, "panda")[-1] == f"`{TODAY[:6]}` / `{BEFORE[:6]}`"
        assert "Of two evaluation codes: 1 of 1" in text
        text = self.text([0.2], [0.1])
        assert cells(text, "panda")[-1] == f"`{TODAY[:6]}`"
        assert "Of two evaluation codes" not in text

    def test_the_default_with_other_settings_is_another_method(self) -> None:
        other = made_row("me_scs", coverage=0.1)
        text = compared(made_row(coverage=0.3), made_row(coverage=0.2, settings="population=70"), other)
        against = [line.split("|")[3].strip() for line in text.splitlines() if line.startswith("| panda")]
        assert against == ["`aimed` for touch (population=70)", "`me_scs`"]
        long = made_row(settings="population=70", budget=10_000)
        assert "| panda" not in coverage_part(arms(*of(long)))


BENCH = {"aimed": "aim_for=hold in_flight=400 population=50 surface_seed=seed"}


def bench_arms(*ends: tuple[str, str, str, float, float]) -> list[Arm]:
    """Arms of the benchmark: hand, object, method, cells that hold in the end and after ten CPU seconds."""
    found = []
    for gripper, target, method, end, after_cpu in ends:
        rows = {
            seed: row(
                method, seed, gripper=gripper, object=target, protocol="physical in mujoco",
                settings=BENCH.get(method, "surface_seed=seed"),
                robust_cells=round(end * (1 + seed / 100)), robust_niches=9, qd_score=9.0,
                robust_cells_5s=1, robust_cells_7s=7, robust_cells_10s=round(after_cpu * (1 + seed / 100)),
            )
            for seed in range(1, 6)
        }  # fmt: skip
        found.append(Arm(rows[1].key._replace(seed=0), tuple(rows), rows))
    return found


def drawn_row(found: Row, share: float) -> Row:
    """A row whose drawn grasps were judged again."""
    return structs.replace(found, drawn=30, drawn_in_bullet=share, drawn_eta=0.9)


class TestBenchmark:
    def test_the_default_of_the_benchmark_is_known_by_its_settings(self) -> None:
        ours, theirs = bench_arms(("panda", "ycb_mug", "aimed", 9, 9), ("panda", "ycb_mug", "me_scs", 9, 9))
        assert (ours.is_default, theirs.is_default) == (True, False)
        assert ours.method == "`aimed`"
        assert ours.key.scene == ("panda", "ycb_mug", "physical in mujoco")

    def test_scenes_held_out_are_summed_up_apart_from_those_of_tuning(self) -> None:
        known = bench_arms(
            *(("panda", name, "aimed", 900, 300) for name in ("ycb_mug", "ycb_bowl", "ycb_banana")),
            *(("panda", name, "me_scs", 300, 100) for name in ("ycb_mug", "ycb_bowl", "ycb_banana")),
        )
        text = benchmark_part(known)
        lines = [line for line in text.splitlines() if "| `me_scs` |" in line]
        assert [line.split("|")[1].strip() for line in lines] == ["held out, two fingers", "tuning"]
        assert [line.split("|")[4:6] for line in lines] == [[" 2 ", " 10 "], [" 1 ", " 5 "]]
        assert "3.00 (2." in lines[0]
        said = re.findall(r"none of \d comparisons after equal \w+", text)
        assert said == [f"none of 3 comparisons after equal {work}" for work in ("evaluations", "CPU")]
        assert "2 of 2 held-out scenes are in" in text
        assert "of tuning scenes 1 of 1." in text

    def test_new_hands_and_objects_have_lines_of_their_own(self) -> None:
        known = bench_arms(
            *(("panda", name, "aimed", 900, 300) for name in ("vase", "ycb_bowl")),
            *(("panda", name, "me_scs", 300, 100) for name in ("vase", "ycb_bowl")),
        )
        lines = [line for line in benchmark_part(known).splitlines() if "| `me_scs` |" in line]
        assert [line.split("|")[1:6:4] for line in lines] == [
            [" held out, two fingers ", " 10 "], [" new hands and objects ", " 5 "]
        ]  # fmt: skip

    def test_a_scene_where_the_default_is_behind_is_named_before_all(self) -> None:
        known = bench_arms(
            ("panda", "ycb_bowl", "aimed", 500, 40), ("panda", "ycb_bowl", "me_scs", 300, 80),
            ("panda", "ycb_banana", "aimed", 100, 40), ("panda", "ycb_banana", "me_scs", 400, 20),
        )  # fmt: skip
        first = benchmark_part(known).partition("Protocol `physical in mujoco`")[0]
        assert "| panda | ycb_bowl | `me_scs` | equal CPU | 0.50 |" in first
        assert "| panda | ycb_banana | `me_scs` | equal evaluations | 0.25 |" in first
        assert first.count("| panda |") == 2
        assert first.count("| loss |") == 2

    def test_equal_cpu_is_the_latest_that_all_runs_reached(self) -> None:
        ours, theirs = bench_arms(
            ("panda", "ycb_bowl", "aimed", 500, 40), ("panda", "ycb_bowl", "me_scs", 300, 20)
        )
        seconds, (found, _) = MethodComparison(ours, theirs).equal_cpu()
        assert (seconds, found.tolist()) == (10, [40, 41, 41, 42, 42])
        short = structs.replace(theirs.rows[3], robust_cells_10s=None)
        late = replace(theirs, rows={**theirs.rows, 3: short})
        seconds, (found, _) = MethodComparison(ours, late).equal_cpu()
        assert (seconds, found.tolist()) == (7, [7, 7, 7, 7, 7])

    def test_runs_too_short_for_equal_cpu_are_counted(self) -> None:
        ours, theirs = bench_arms(
            ("panda", "ycb_bowl", "aimed", 500, 40), ("panda", "ycb_bowl", "me_scs", 300, 20)
        )
        none = dict.fromkeys(("robust_cells_5s", "robust_cells_7s", "robust_cells_10s"))
        short = {seed: structs.replace(row, **none) for seed, row in theirs.rows.items()}
        text = benchmark_part([ours, replace(theirs, rows=short)])
        assert "none of 0 comparisons after equal CPU (1 more has a run too short for that)." in text

    def test_the_best_other_is_one_that_found_something_where_the_default_did_not(self) -> None:
        arms = bench_arms(*(("panda", "ycb_bowl", *one) for one in (
            ("aimed", 0, 40), ("me_scs", 0, 20), ("contact_me_scs", 100, 20)
        )))  # fmt: skip
        (line,) = (line for line in benchmark_part(arms).splitlines() if BEST_OTHER in line)
        assert line.split(" | ")[12] == "0.00 (0.00 to 0.00)"

    def test_grasps_judged_again_weigh_cells_by_the_share_that_holds_in_both_engines(self) -> None:
        ours, theirs = bench_arms(
            ("panda", "ycb_bowl", "aimed", 1000, 40), ("panda", "ycb_bowl", "me_scs", 100, 20)
        )
        assert "In the other engine" not in benchmark_part([ours, theirs])
        arms = [
            replace(arm, rows={seed: drawn_row(row, share) for seed, row in arm.rows.items()})
            for arm, share in ((ours, 0.5), (theirs, 1.0))
        ]
        text = benchmark_part(arms).partition("### In the other engine")[2]
        first, second = (line.split(" | ") for line in text.splitlines() if line.startswith("| held out"))
        assert first[2:8] == ["1", "1", "150", "50", "0.90", "515"]
        assert second[4:8] == ["150", "100", "0.90", "103"]
        assert second[8].startswith("5.00 (")

    def test_a_scene_that_is_judged_in_part_is_left_out(self) -> None:
        ours, theirs = bench_arms(
            ("panda", "ycb_bowl", "aimed", 1000, 40), ("panda", "ycb_bowl", "me_scs", 100, 20)
        )
        some = {seed: drawn_row(row, 1.0) if seed > 1 else row for seed, row in ours.rows.items()}
        assert "In the other engine" not in benchmark_part([replace(ours, rows=some), theirs])

    def test_without_a_run_it_says_so_and_draws_nothing(self) -> None:
        assert "No runs of the benchmark are in yet" in benchmark_part([])
        assert draw([]) is None


def test_the_ceiling_is_a_new_cell_with_every_success() -> None:
    found = made_row(
        object="ycb_rubiks_cube", budget=10_000, set_size=1000, coverage=0.5, cpu_seconds=10.0,
        coverage_per_cpu_second=0.05, success_ms=10.0,
    )  # fmt: skip
    line = cells(cpu_part(arms(*of(found))), "panda")
    assert line[8:12] == ["5.000", "10.0", "10.00", "50"]


@pytest.mark.parametrize("figure", ["coverage", "cpu_seconds"])
def test_an_arm_without_a_run_has_no_number(figure: str) -> None:
    (arm,) = arms(*of(absent=(made_row(),)))
    assert arm.words(figure) == ""


def test_holm_multiplies_each_p_value_by_those_that_are_not_smaller() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_holm_leaves_out_comparisons_without_a_p_value_and_stops_at_one() -> None:
    assert holm([0.6, np.nan, 0.7]) == pytest.approx([1.0, np.nan, 1.0], nan_ok=True)
    assert holm([]).shape == (0,)
