"""The table of results and its page."""

import random
import re
from pathlib import Path
from typing import Any

import pytest
from benchmarks.results import table
from benchmarks.results import table as tables
from benchmarks.results.assets import NAME, OBJECTS
from benchmarks.results.comparison import arms, comparison_part
from benchmarks.results.page import coverage_part, cpu_part, page
from benchmarks.results.programme import Programme, Wanted, programme
from benchmarks.results.table import COLUMNS, Row, key
from msgspec.structs import replace

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
        there = replace(here, gripper=f"/data/{NAME}/xarm.toml", object=f"/data/{NAME}/vase.stl")
        assert key(here) == key(there)
        assert (key(here).gripper, key(here).object, key(here).settings) == ("xarm", "vase", "")
        assert key(replace(here, mass=1.0)).settings == "mass=1.0"

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
            (",0.1.0", "", "line 2: expected 35 fields"),
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
    assert (RESULTS / "index.md").read_text(encoding="utf-8") == page(programme(), whole)


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


class TestDuels:
    def text(self, ours: dict[int, float], theirs: dict[int, float]) -> str:
        rows = [made_row(seed=seed, coverage=value, robust_coverage=0.3) for seed, value in ours.items()]
        others = ((seed, {"coverage": value, "robust_coverage": 0.4}) for seed, value in theirs.items())
        return compared(*rows, *(made_row("me_scs", seed, **figures) for seed, figures in others))

    def test_differences_are_of_runs_with_one_seed(self) -> None:
        text = self.text({0: 0.2, 1: 0.3, 2: 0.9}, {0: 0.1, 1: 0.2})
        line = cells(text, "panda")
        assert line[3] == "2"
        assert line[5:7] == ["25.0 (20.0 to 30.0)", "15.0 (10.0 to 20.0)"]
        assert line[7:10] == ["+10.0", "+10.0 to +10.0", "win"]

    def test_an_interval_around_zero_is_nobodys_win(self) -> None:
        text = self.text({0: 0.2, 1: 0.2}, {0: 0.1, 1: 0.3})
        assert cells(text, "panda")[9] == "level"

    def test_one_seed_proves_nothing(self) -> None:
        assert cells(self.text({0: 0.2}, {0: 0.1}), "panda")[8:10] == ["", "one seed"]

    def test_losses_are_listed_in_every_figure(self) -> None:
        text = self.text({0: 0.1, 1: 0.1}, {0: 0.2, 1: 0.2})
        assert "losses 1. Behind nowhere in: mean best fitness; orientations; niches." in text
        assert "| coverage, or cells | panda | ycb_mug | `me_scs` 10.0 |  |" in text
        assert "| robust coverage | panda | ycb_mug | `me_scs` 10.0 |  |" in text

    def test_who_is_ahead_but_not_for_certain_stands_apart(self) -> None:
        text = self.text({0: 0.2, 1: 0.2}, {0: 0.1, 1: 0.4})
        assert "| coverage, or cells | panda | ycb_mug |  | `me_scs` 5.0 |" in text

    def test_where_there_is_no_set_cells_are_compared(self) -> None:
        counts = {"aimed": 100, "me_scs": 60}
        rows = [made_row(method, seed, cells=count) for method, count in counts.items() for seed in (0, 1)]
        found = cells(compared(*rows), "panda")[4:8]
        assert found == ["cells", "100 (100 to 100)", "60 (60 to 60)", "+40"]

    def test_several_objects_are_also_taken_together(self) -> None:
        rows = [
            made_row(method, seed, object=name, coverage=value)
            for method, value in (("aimed", 0.3), ("me_scs", 0.1))
            for name in ("ycb_mug", "ycb_bowl")
            for seed in (0, 1)
        ]
        assert "| panda | `me_scs` | 2 | coverage, % | +20.0 | +20.0 to +20.0 | win |" in compared(*rows)

    def test_countings_are_kept_apart(self) -> None:
        other = made_row("me_scs", coverage=0.1)
        text = compared(made_row(coverage=0.2), made_row(coverage=0.5, overlaps="redraw"), other)
        assert re.findall("^### .*", text, re.MULTILINE) == [
            "### 1,000 evaluations, every pose counted",
            "### 1,000 evaluations, every pose counted; default: overlaps redrawn",
        ]

    def test_two_evaluation_codes_are_marked_and_one_is_not(self) -> None:
        text = compared(made_row(coverage=0.2), made_row("me_scs", coverage=0.1, code=BEFORE))
        assert cells(text, "panda")[-1] == f"`{TODAY[:6]}` / `{BEFORE[:6]}`"
        assert "Of two evaluation codes: 1 of 1" in text
        text = self.text({0: 0.2}, {0: 0.1})
        assert cells(text, "panda")[-1] == f"`{TODAY[:6]}`"
        assert "Of two evaluation codes" not in text

    def test_the_default_with_other_settings_is_another_method(self) -> None:
        other = made_row("me_scs", coverage=0.1)
        text = compared(made_row(coverage=0.3), made_row(coverage=0.2, settings="population=70"), other)
        against = [line.split("|")[3].strip() for line in text.splitlines() if line.startswith("| panda")]
        assert against == ["`aimed` (population=70)", "`me_scs`"]
        long = made_row(settings="population=70", budget=10_000)
        assert "| panda" not in coverage_part(arms(*of(long)))


BESIDE_THE_AUTHORS = {"object": "ycb_rubiks_cube", "budget": 10_000}


@pytest.mark.parametrize(
    ("other", "times"),
    [({}, "63.3"), ({"budget": 5000}, ""), ({"object": "ycb_mug"}, ""), ({"protocol": "released"}, "")],
)
def test_the_authors_rate_stands_beside_runs_like_theirs_alone(other: dict[str, Any], times: str) -> None:
    found = made_row(**BESIDE_THE_AUTHORS | other, coverage=0.5, coverage_per_cpu_second=0.05)
    assert cells(cpu_part(arms(*of(found))), "panda")[9] == times


def test_the_ceiling_is_a_new_cell_with_every_success() -> None:
    found = made_row(
        **BESIDE_THE_AUTHORS, set_size=1000, coverage=0.5, cpu_seconds=10.0, coverage_per_cpu_second=0.05,
        success_ms=10.0,
    )  # fmt: skip
    line = cells(cpu_part(arms(*of(found))), "panda")
    assert line[8:13] == ["5.000", f"{5 / 0.079:.1f}", "10.0", "10.00", "50"]


@pytest.mark.parametrize("figure", ["coverage", "cpu_seconds"])
def test_an_arm_without_a_run_has_no_number(figure: str) -> None:
    (arm,) = arms(*of(absent=(made_row(),)))
    assert arm.words(figure) == ""
